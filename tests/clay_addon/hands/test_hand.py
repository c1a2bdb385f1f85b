# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands in Blender: binding rigged meshes, storing them, and detecting changes."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from tactile_clay.clay_addon.hands.hand import (
    hand_bone_matrices,
    hand_message,
    hand_objects,
    make_hand,
    read_hand_rig,
)
from tactile_clay.clay_addon.hands.reading import HandError
from tactile_clay.clay_addon.hands.store import PROPERTY, is_stored
from tactile_clay.solver.hand.default_hand import default_hand
from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.hand.shape import POSES, hand_shape

COARSE = 0.02
"""Spacing of clay that needs few ghosts [m]."""


@pytest.fixture(scope="module")
def hand_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hand") / "hand.blend"


@pytest.fixture
def hand(studio: Any, hand_file: Path) -> Any:
    """The bound default right hand, without animation; from a file, to bind it only once."""
    if not hand_file.exists():
        studio.scene.tactile_clay.spacing = COARSE
        assert bpy.ops.clay.hand_add(side="RIGHT") == {"FINISHED"}
        studio.save(hand_file.parent, hand_file.name)
    bpy.ops.wm.open_mainfile(filepath=str(hand_file))
    (item,) = hand_objects(studio.scene)
    return item


def read(item: Any) -> HandRig:
    return read_hand_rig(bpy.context, item)


def matrices(item: Any) -> dict[str, np.ndarray]:
    return hand_bone_matrices(item, bpy.context.evaluated_depsgraph_get())


def world_vertices(item: Any) -> np.ndarray:
    """Vertices of a hand's skin as evaluated by Blender [Blender units], shape [V, 3]."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = np.array([vertex.co for vertex in mesh.vertices])
    evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def bend(item: Any, angle: float = 0.9) -> None:
    """Bend all fingers of a default hand."""
    for bone in item.parent.pose.bones:
        if bone.name.endswith(("proximal", "intermediate", "distal")):
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = (-angle, 0.0, 0.0)
    bpy.context.view_layer.update()


def test_added_hand_has_the_bones_of_openxr(studio: Any, hand: Any) -> None:
    """Give each bone the rest matrix of the default hand, to a hundredth of a millimeter."""
    expected = default_hand()
    rig = hand.parent.data
    assert [bone.name for bone in rig.bones] == list(expected.bone_names)
    for bone, matrix in zip(rig.bones, expected.bone_rest, strict=True):
        np.testing.assert_allclose(np.array(bone.matrix_local), matrix, atol=1e-5)
        parent = bone.parent and bone.parent.name
        index = expected.bone_parent[expected.bone_names.index(bone.name)]
        assert parent == (expected.bone_names[index] if index >= 0 else None)


def test_bound_hand_is_read_in_the_rest_pose(studio: Any, hand: Any) -> None:
    """Read bone matrices equal to the rest matrices, and a rig that fits the skin."""
    rig = read(hand)
    assert rig.side == "right"
    now = matrices(hand)
    assert set(rig.bone_names) <= set(now)
    for name, rest in zip(rig.bone_names, rig.bone_rest, strict=True):
        np.testing.assert_allclose(now[name], rest, atol=1e-6)
    assert np.abs(rig.carried_vertices(rig.nodes) - world_vertices(hand)).max() < 1e-6
    assert hand_message(studio.scene, hand) == ""


def test_skin_of_the_solver_follows_blenders(studio: Any, hand: Any) -> None:
    """Pose bones in Blender, and find the skin embedded in tetrahedra close to Blender's skin."""
    rig = read(hand)
    bend(hand)
    hand.parent.matrix_world = Matrix.Translation((0.3, -0.2, 1.0)) @ Matrix.Rotation(
        1.0, 4, (1.0, 2.0, 0.5)
    )
    bpy.context.view_layer.update()
    carried = rig.carried_vertices(rig.skinned_nodes(matrices(hand)))
    errors = np.linalg.norm(carried - world_vertices(hand), axis=1)
    assert np.median(errors) < 5e-4
    assert errors.max() < 8e-3


def test_joint_poses_pose_the_armature(studio: Any, hand: Any) -> None:
    """Set each bone's matrix to a joint's pose, as tracking does, and find the joint there."""
    shape = hand_shape(pose=POSES["pinch"])
    for bone in hand.parent.pose.bones:
        right, ahead, up = shape.axes[bone.name].T
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([right, up, -ahead, shape.joints[bone.name]])
        bone.matrix = Matrix(matrix.tolist())
        bpy.context.view_layer.update()
    now = matrices(hand)
    for name in ("thumb_tip", "index_tip", "little_distal"):
        np.testing.assert_allclose(now[name][:3, 3], shape.joints[name], atol=1e-5)


@pytest.mark.parametrize("scale", [0.01, 10.0])
def test_unit_scale_gives_meters(studio: Any, scale: float) -> None:
    """Give the solver meters for any length of a Blender unit."""
    studio.scene.unit_settings.scale_length = scale
    studio.scene.tactile_clay.spacing = COARSE / scale
    bpy.ops.clay.hand_add(side="LEFT", length=0.15)
    (item,) = hand_objects(studio.scene)
    rig = read(item)
    assert rig.ghost_spacing == pytest.approx(0.5 * COARSE, rel=1e-5)
    assert np.ptp(rig.vertices[:, 1]) == pytest.approx(0.15 * (0.188 + 0.034) / 0.19, rel=0.02)
    np.testing.assert_allclose(
        rig.carried_vertices(rig.nodes), world_vertices(item) * scale, atol=1e-6
    )
    for name, rest in zip(rig.bone_names, rig.bone_rest, strict=True):
        np.testing.assert_allclose(matrices(item)[name], rest, atol=1e-6)


def test_non_uniform_scale_is_applied(studio: Any, hand: Any) -> None:
    """Bind the hand in its visible size, and pose it as Blender does."""
    hand.parent.scale = (1.3, 0.8, 1.1)
    bpy.context.view_layer.update()
    with pytest.raises(HandError, match="its size has changed"):
        read(hand)
    make_hand(bpy.context, hand, clay_spacing=COARSE)
    rig = read(hand)
    np.testing.assert_allclose(rig.carried_vertices(rig.nodes), world_vertices(hand), atol=1e-6)
    bend(hand, 0.5)
    carried = rig.carried_vertices(rig.skinned_nodes(matrices(hand)))
    errors = np.linalg.norm(carried - world_vertices(hand), axis=1)
    assert np.median(errors) < 5e-4 and errors.max() < 8e-3


def test_posed_hand_is_bound_at_rest(studio: Any, hand: Any) -> None:
    """Bind a posed hand in its rest pose, and keep the pose."""
    before = read(hand)
    bend(hand)
    posed = world_vertices(hand)
    make_hand(bpy.context, hand)
    np.testing.assert_allclose(read(hand).vertices, before.vertices, atol=1e-7)
    np.testing.assert_array_equal(world_vertices(hand), posed)
    # Armature, skin and the bones' custom shape.
    assert len(bpy.data.objects) == 3


def test_hand_is_saved_in_the_file(studio: Any, hand: Any, tmp_path: Path) -> None:
    """Read the same bits after saving and loading."""
    before = read(hand)
    path = studio.save(tmp_path)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    (item,) = hand_objects(bpy.context.scene)
    assert hand_message(bpy.context.scene, item) == ""
    after = read(item)
    for name, array in before.to_arrays().items():
        np.testing.assert_array_equal(array, after.to_arrays()[name], err_msg=name)


def test_duplicate_is_an_independent_hand(studio: Any, hand: Any) -> None:
    """Read a duplicate of mesh and armature that was moved."""
    studio.select(hand, hand.parent)
    bpy.ops.object.duplicate()
    (copy,) = (item for item in hand_objects(studio.scene) if item != hand)
    assert copy.data != hand.data
    copy.parent.location = (0.5, 0.0, 0.0)
    bpy.context.view_layer.update()
    rig = read(copy)
    moved = rig.carried_vertices(rig.skinned_nodes(matrices(copy)))
    np.testing.assert_allclose(moved, world_vertices(copy), atol=1e-6)
    bpy.ops.clay.hand_remove()
    assert copy.tactile_clay.role == "NONE" and not is_stored(copy.data)
    assert read(hand) is not None


def change_vertex(item: Any) -> None:
    item.data.vertices[10].co.z += 0.01


def change_weight(item: Any) -> None:
    index = int(np.argmax([vertex.co.y for vertex in item.data.vertices]))
    item.vertex_groups["wrist"].add([index], 0.5, "ADD")


def change_modifier(item: Any) -> None:
    item.modifiers.new("Thick", "DISPLACE").strength = 0.002


def change_bone(item: Any) -> None:
    bpy.context.view_layer.objects.active = item.parent
    bpy.ops.object.mode_set(mode="EDIT")
    item.parent.data.edit_bones["index_distal"].head.x += 0.01
    bpy.ops.object.mode_set(mode="OBJECT")


def change_size(item: Any) -> None:
    item.parent.scale = (1.1, 1.1, 1.1)


def change_place_in_armature(item: Any) -> None:
    item.location.x += 0.01


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (change_vertex, "its mesh has changed"),
        (change_weight, "vertex weights have changed"),
        (change_modifier, "its mesh has changed"),
        (change_bone, "rest pose has changed"),
        (change_size, "its size has changed"),
        (change_place_in_armature, "moved relative to its armature"),
    ],
)
def test_changed_hand_is_reported(studio: Any, hand: Any, change: Any, words: str) -> None:
    """Say what has changed since the hand was bound, until it is bound again."""
    change(hand)
    bpy.context.view_layer.update()
    with pytest.raises(HandError, match=words):
        read(hand)
    if change not in (change_place_in_armature, change_weight):
        assert "has changed since it was bound" in hand_message(studio.scene, hand)
    make_hand(bpy.context, hand)
    assert read(hand) is not None
    assert hand_message(studio.scene, hand) == ""


def test_clay_of_another_spacing_is_reported(studio: Any, hand: Any) -> None:
    """Say that the ghosts do not fit clay of another spacing, but still read the hand."""
    clay = studio.clay()
    assert clay.tactile_clay.spacing != COARSE
    assert "clay with another particle spacing" in hand_message(studio.scene, hand)
    assert read(hand).ghost_spacing == pytest.approx(0.5 * COARSE)
    make_hand(bpy.context, hand)
    assert hand_message(studio.scene, hand) == ""
    assert read(hand).ghost_spacing == pytest.approx(0.5 * clay.tactile_clay.spacing)


@pytest.mark.parametrize("stored", [b"", b"no archive", "text", 3])
def test_corrupt_hand_is_reported(studio: Any, hand: Any, stored: Any) -> None:
    """Say that the stored binding is corrupt, whatever it contains."""
    hand.data[PROPERTY] = stored
    with pytest.raises(HandError, match=r"corrupt|not bound"):
        read(hand)


def test_lost_armature_is_reported(studio: Any, hand: Any) -> None:
    """Say that there is no longer an armature."""
    bpy.data.objects.remove(hand.parent)
    bpy.context.view_layer.update()
    with pytest.raises(HandError, match="not rigged"):
        read(hand)
    with pytest.raises(HandError, match="not rigged"):
        matrices(hand)
    assert "not rigged" in hand_message(studio.scene, hand)


def test_bone_that_is_not_finite_is_reported(studio: Any, hand: Any) -> None:
    """Name the bone and the frame."""
    hand.parent.pose.bones["ring_distal"].location.x = float("nan")
    bpy.context.view_layer.update()
    with pytest.raises(HandError, match=r"'ring_distal' .* not finite .* frame 1"):
        matrices(hand)
