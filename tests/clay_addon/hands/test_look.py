# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand's material: nails on the backs of fingertips."""

from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.hands.look import add_hand_look, nail_coordinates
from tactile_clay.solver.hand.default_hand import default_hand


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_finger_has_a_nail_on_its_back(side: str) -> None:
    """Place five nails at the ends of fingers, facing along the bone's Y."""
    hand = default_hand(side)
    coordinates = nail_coordinates(hand)
    on_nail = (np.abs(coordinates[:, :2]) < 1.0).all(1) & (coordinates[:, 2] > 0.15)
    strongest = np.array([hand.bone_names[bone] for bone in hand.weights.argmax(1)])
    assert set(strongest[on_nail]) == {
        f"{finger}_distal" for finger in ("thumb", "index", "middle", "ring", "little")
    }
    first, second, third = np.moveaxis(hand.vertices[hand.faces], 1, 0)
    normals = np.zeros_like(hand.vertices)
    face_normals = np.cross(second - first, third - first)
    for corner in hand.faces.T:
        np.add.at(normals, corner, face_normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for bone, name in enumerate(hand.bone_names):
        if name.endswith("distal"):
            own = on_nail & (strongest == name)
            assert own.sum() >= 3
            assert (normals[own] @ hand.bone_rest[bone, :3, 1]).mean() > 0.6


def test_hands_share_one_material(studio: Any) -> None:
    """Store the nails in the mesh, so that hands can share the material."""
    hand = default_hand()
    meshes = []
    for name in ("first", "second"):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(hand.vertices.tolist(), [], hand.faces.tolist())
        add_hand_look(mesh, hand)
        meshes.append(mesh)
    assert meshes[0].materials[0] == meshes[1].materials[0]
    assert len(bpy.data.materials) == 1
    stored = np.array([value.vector for value in meshes[1].attributes["nail"].data])
    np.testing.assert_allclose(stored, nail_coordinates(hand), rtol=1e-6)
