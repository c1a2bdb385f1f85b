# SPDX-License-Identifier: GPL-3.0-or-later
"""Tetrahedra inside a hand: correct volume, well shaped, and no fingers connected."""

import numpy as np
import pytest

from tactile_clay.solver.geometry.closed_mesh import mesh_volume
from tactile_clay.solver.geometry.lattice_tetrahedra import (
    tetrahedron_qualities,
    tetrahedron_volumes,
)
from tactile_clay.solver.geometry.skin_query import SkinQuery
from tactile_clay.solver.hand.default_hand import default_hand
from tactile_clay.solver.hand.flesh import hand_flesh
from tactile_clay.solver.hand.parts import PALM, hand_parts
from tactile_clay.solver.hand.skinned_hand import SkinnedHand

FINGERS = ("thumb", "index", "middle", "ring", "little")


@pytest.fixture(scope="module")
def hand() -> SkinnedHand:
    return default_hand()


@pytest.mark.parametrize("cell", [0.004, 0.006, 0.008, 0.010, 0.013, 0.016])
def test_fingers_share_no_nodes(hand: SkinnedHand, cell: float) -> None:
    """Connect no finger to another, nor to the palm next to it, at any lattice size."""
    parts = hand_parts(hand.vertices, hand.faces)
    skin = SkinQuery(hand.vertices, hand.faces)
    flesh = hand_flesh(skin, hand.vertices, hand.faces, parts, cell)
    points, corners = flesh.tetrahedra.points, flesh.tetrahedra.corners
    assert tetrahedron_volumes(points, corners).min() > 0.0
    assert tetrahedron_qualities(points, corners).min() >= 0.4
    volume = mesh_volume(hand.vertices, hand.faces)
    assert tetrahedron_volumes(points, corners).sum() == pytest.approx(volume, rel=0.025)
    palm = set(corners[(flesh.part == PALM) & ~flesh.at_root].ravel().tolist())
    owners = [set(corners[flesh.part == number].ravel().tolist()) for number in range(1, 6)]
    for first in range(5):
        for second in range(first):
            assert owners[first] & owners[second] <= palm
    for finger in FINGERS:
        end = hand.weights.argmax(1) == hand.bone_names.index(f"{finger}_distal")
        (number,) = np.unique(parts.part[end])
        own = np.unique(corners[flesh.part == number])
        root = hand.bone_rest[hand.bone_names.index(f"{finger}_distal")]
        beyond = own[(points[own] - root[:3, 3]) @ -root[:3, 2] > 0.0]
        others = np.unique(corners[flesh.part != number])
        assert len(beyond) > 3
        assert not np.isin(beyond, others).any()
