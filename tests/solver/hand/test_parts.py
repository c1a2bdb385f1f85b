# SPDX-License-Identifier: GPL-3.0-or-later
"""Dividing the skin into fingers and palm by its shape."""

import numpy as np
import pytest
import trimesh

from tactile_clay.solver.hand.default_hand import default_hand
from tactile_clay.solver.hand.parts import PALM, HandParts, distances_from, hand_parts, skin_edges
from tactile_clay.solver.hand.skinned_hand import SkinnedHand

from .hand_poses import FIST, pose_bones

FINGERS = ("thumb", "index", "middle", "ring", "little")


@pytest.fixture(scope="module")
def hand() -> SkinnedHand:
    return default_hand()


def check_fingers(hand: SkinnedHand, parts: HandParts) -> None:
    """Check that there are five free fingers, each with the skin of its own outer bones."""
    assert parts.finger_count == 5
    strongest = np.array([hand.bone_names[bone] for bone in hand.weights.argmax(1)])
    numbers = []
    for finger in FINGERS:
        outer = np.isin(strongest, [f"{finger}_intermediate", f"{finger}_distal"])
        number = int(np.bincount(parts.part[outer]).argmax())
        numbers.append(number)
        assert (parts.part[strongest == f"{finger}_distal"] == number).all()
        assert (parts.part[outer] == number).mean() > 0.95
        own = np.char.startswith(strongest[parts.part == number], finger)
        assert own.mean() > 0.95
    assert sorted(numbers) == [1, 2, 3, 4, 5]
    assert (parts.part[strongest == "wrist"] == PALM).all()
    np.testing.assert_array_equal((parts.beyond < 0.0).any(1), parts.part != PALM)
    assert ((parts.beyond < 0.0).sum(1) <= 1).all()


def test_fingers_are_free_beyond_the_web(hand: SkinnedHand) -> None:
    """Find five fingers, each starting between its knuckle and its first joint."""
    parts = hand_parts(hand.vertices, hand.faces)
    check_fingers(hand, parts)
    heads = dict(zip(hand.bone_names, hand.bone_rest[:, :3, 3], strict=True))
    strongest = np.array([hand.bone_names[bone] for bone in hand.weights.argmax(1)])
    for finger in FINGERS[1:]:
        (number,) = np.unique(parts.part[strongest == f"{finger}_distal"])
        lowest = hand.vertices[parts.part == number, 1].min()
        assert heads[f"{finger}_proximal"][1] < lowest < heads[f"{finger}_intermediate"][1]


@pytest.mark.parametrize("pose", ["pinch", "point", FIST], ids=["pinch", "point", "fist"])
def test_touching_fingers_are_separated(hand: SkinnedHand, pose: object) -> None:
    """Separate fingers that touch each other and the palm."""
    posed = hand.posed(pose_bones(pose))  # type: ignore[arg-type]
    check_fingers(hand, hand_parts(posed, hand.faces))


def test_order_and_position_of_vertices_do_not_matter(hand: SkinnedHand) -> None:
    """Find the same parts for any order of vertices, position and size."""
    order = np.random.default_rng(0).permutation(len(hand.vertices))
    index = np.argsort(order).astype(np.int32)
    shuffled = hand_parts(10.0 * hand.vertices[order] + 3.0, index[hand.faces])
    parts = hand_parts(hand.vertices, hand.faces)
    free = parts.part != PALM
    assert (free == (shuffled.part[index] != PALM)).mean() > 0.95
    assert shuffled.finger_count == 5


@pytest.mark.parametrize("arm", [0.02, 8.0], ids=["no wrist", "forearm"])
def test_arm_may_be_short_or_long(hand: SkinnedHand, arm: float) -> None:
    """Find the fingers of a hand cut off at the wrist, and of one with a whole arm."""
    below = hand.vertices[:, 1] < 0.0
    vertices = hand.vertices.copy()
    vertices[below, 1] *= arm
    parts = hand_parts(vertices, hand.faces)
    before = hand_parts(hand.vertices, hand.faces)
    assert parts.finger_count == 5
    assert ((parts.part != PALM) == (before.part != PALM)).mean() > 0.97


def test_ball_has_no_fingers() -> None:
    """Return a single part for a ball."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    parts = hand_parts(ball.vertices, ball.faces.astype(np.int32))
    assert parts.finger_count == 0
    assert (parts.part == PALM).all() and parts.beyond.shape == (len(ball.vertices), 0)


def test_distances_along_the_skin() -> None:
    """Compute distances along the edges of a unit cube from one corner."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    edges = skin_edges(box.faces.astype(np.int32))
    lengths = np.linalg.norm(np.diff(box.vertices[edges], axis=1)[:, 0], axis=1)
    straight = np.isclose(lengths, 1.0)
    distances = distances_from(0, edges[straight], lengths[straight])
    np.testing.assert_allclose(distances, np.abs(box.vertices - box.vertices[0]).sum(1))
