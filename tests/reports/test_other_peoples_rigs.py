# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands as other people rig them have their flesh where one sees their skin, or it is said."""

import os
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.base.mesh_geometry import evaluated_mesh, transform, world_matrix
from tactile_clay.clay_addon.hands.add_hand import add_hand
from tactile_clay.clay_addon.hands.gap import skin_gap
from tactile_clay.clay_addon.hands.hand import hand_bone_matrices, make_hand, read_hand_rig
from tactile_clay.clay_addon.hands.reading import HandError
from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.geometry.skin_query import SkinQuery

BENT = 0.6
"""How far each joint of a finger is bent [rad]."""


def bend(hand: Any, angle: float = BENT) -> None:
    """Bend all fingers, and turn the wrist."""
    for bone in hand.find_armature().pose.bones:
        bone.rotation_mode = "XYZ"
        still = any(word in bone.name for word in ("wrist", "palm", "metacarpal"))
        bone.rotation_euler = (0.1 if still else angle, 0.0, 0.0)
    bpy.context.view_layer.update()


SCALES = [(-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1), (-1.3, 1.3, 1.3), (1, 1, 1)]


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_mirrored_hand_has_its_flesh_in_its_skin(
    studio: Any, scale: tuple[float, float, float], side: str, turned: bool
) -> None:
    """Whatever axis is mirrored, and whether the solver or the measure is asked."""
    hand = add_hand(bpy.context, side)
    rig_object = hand.find_armature()
    rig_object.scale = scale
    if turned:
        rig_object.rotation_euler = (0.4, -1.1, 2.0)
    bpy.context.view_layer.update()
    make_hand(bpy.context, hand)
    rig = read_hand_rig(bpy.context, hand)
    bend(hand)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    gap = skin_gap(hand, rig, depsgraph)
    assert gap is not None
    assert gap.meters < 0.02 * gap.length
    # The solver's own skin.
    scene = Scene(spacing=0.005)
    scene.add_clay(np.array([[9.0, 9.0, 9.0]]), Material())
    handle = scene.add_hand(rig)
    matrices = hand_bone_matrices(hand, depsgraph)
    handle.set_bones(np.stack([matrices[name] for name in rig.bone_names]))
    solver = Solver(scene)
    solver.step()
    vertices, triangles = evaluated_mesh(hand, depsgraph)
    shown = transform(world_matrix(hand, depsgraph), vertices)
    ghosts = solver.contacts(handle).positions
    depth = SkinQuery(shown, triangles).nearest(np.asarray(ghosts, np.float64)).depth
    assert np.abs(depth).max() < 0.02 * gap.length


def scaled_by_keys(hand: Any) -> None:
    """Key the armature's size."""
    rig = hand.find_armature()
    for frame, size in ((1, 1.0), (4, 1.4)):
        rig.scale = (size,) * 3
        rig.keyframe_insert("scale", frame=frame)


def with_envelopes(hand: Any) -> None:
    """Let bones' envelopes carry the skin, too."""
    for modifier in hand.modifiers:
        if modifier.type == "ARMATURE":
            modifier.use_bone_envelopes = True
            modifier.use_vertex_groups = False


def with_a_limited_modifier(hand: Any) -> None:
    """Let only a few vertices follow the armature."""
    group = hand.vertex_groups.new(name="few")
    group.add(list(range(40)), 1.0, "REPLACE")
    for modifier in hand.modifiers:
        if modifier.type == "ARMATURE":
            modifier.vertex_group = "few"


def with_another_deformer(hand: Any) -> None:
    """Bend the mesh by something that no bone does, at the last frame."""
    modifier = hand.modifiers.new("Twist", "SIMPLE_DEFORM")
    modifier.deform_method = "BEND"
    modifier.deform_axis = "X"
    for frame, angle in ((1, 0.0), (4, 1.2)):
        modifier.angle = angle
        modifier.keyframe_insert("angle", frame=frame)


def with_a_shape_key(hand: Any) -> None:
    """Move vertices by a shape key that comes in at the last frame."""
    hand.shape_key_add(name="Basis")
    key = hand.shape_key_add(name="Spread")
    for point in key.data:
        point.co.y *= 1.5
    for frame, value in ((1, 0.0), (4, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)


FOREIGN = [with_envelopes, with_a_limited_modifier, with_another_deformer, with_a_shape_key]


@pytest.mark.parametrize("change", [scaled_by_keys, *FOREIGN])
def test_what_flesh_cannot_follow_is_told_or_refused(
    studio: Any, tmp_path: Path, change: Any
) -> None:
    """With the distance, at the first or the last frame of a bake; what fits says nothing."""
    studio.clay(location=(0.0, 0.5, 0.0))
    hand = add_hand(bpy.context, "right")
    change(hand)
    bend(hand)
    for bone in hand.find_armature().pose.bones:
        bone.keyframe_insert("rotation_euler", frame=1)
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    try:
        make_hand(bpy.context, hand)
        result = bake(bpy.context, start=1, end=4)
    except HandError as refused:
        assert "Right hand" in str(refused)
        return
    told = [text for text in result.warnings if "The flesh of 'Right hand' lies up to" in text]
    if change is scaled_by_keys:
        # Bones that grow carry the flesh along.
        assert not told
        return
    assert len(told) == 1
    assert "mm beside the mesh that is shown" in told[0]


def test_make_clay_hand_says_how_far_flesh_is_from_skin(studio: Any) -> None:
    """Also where it fits."""
    hand = add_hand(bpy.context, "right")
    bend(hand)
    studio.select(hand)
    assert bpy.ops.clay.hand_make() == {"FINISHED"}
    with_envelopes(hand)
    bend(hand, 1.0)
    assert bpy.ops.clay.hand_make() == {"FINISHED"}


def overridden_cube(folder: Path) -> Any:
    """A library override of a cube, in a file that was saved beside its library."""
    bpy.ops.mesh.primitive_cube_add(size=0.1)
    cube = bpy.context.object
    collection = bpy.data.collections.new("Set")
    collection.objects.link(cube)
    bpy.data.libraries.write(str(folder / "library.blend"), {collection})
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(folder / "library.blend"), link=True) as (_, into):
        into.collections = ["Set"]
    linked = into.collections[0]
    bpy.context.scene.collection.children.link(linked)
    linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    return next(item for item in bpy.context.scene.objects if item.override_library)


def test_a_library_override_stays_a_collider(studio: Any, tmp_path: Path) -> None:
    """With its values, after the file is opened again."""
    item = overridden_cube(tmp_path)
    studio.select(item)
    assert bpy.ops.clay.collider_add() == {"FINISHED"}
    item.tactile_clay.collider_friction = 0.7
    item.tactile_clay.wheel_speed = 30.0
    name = item.name
    path = studio.save(tmp_path)
    bpy.ops.wm.open_mainfile(filepath=os.fspath(path))
    (again,) = [i for i in bpy.context.scene.objects if i.override_library]
    assert again.name == name
    assert again.tactile_clay.role == "COLLIDER"
    assert again.tactile_clay.collider_friction == pytest.approx(0.7)
    assert again.tactile_clay.wheel_speed == pytest.approx(30.0)


def test_clay_is_made_of_a_library_override(studio: Any, tmp_path: Path) -> None:
    """The clay is local, and its source stays linked."""
    item = overridden_cube(tmp_path)
    studio.select(item)
    studio.scene.tactile_clay.spacing = 0.02
    assert bpy.ops.clay.make() == {"FINISHED"}
    path = studio.save(tmp_path)
    bpy.ops.wm.open_mainfile(filepath=os.fspath(path))
    (clay,) = [i for i in bpy.context.scene.objects if i.tactile_clay.role == "CLAY"]
    assert len(clay.data.points) == 125
    assert clay.library is None
