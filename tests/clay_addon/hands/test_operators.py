# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for clay hands: results, refusals and Undo."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bmesh
import bpy
import pytest
from mathutils import Vector

from tactile_clay.clay_addon.hands.hand import hand_objects
from tactile_clay.clay_addon.hands.store import PROPERTY, is_stored
from tactile_clay.clay_addon.panel import CLAY_PT_hands

from ..test_panel import Layout


@pytest.fixture(autouse=True)
def few_ghosts(studio: Any) -> None:
    """Use coarse clay, so that binding is fast."""
    studio.scene.tactile_clay.spacing = 0.02


def added(studio: Any, **options: Any) -> Any:
    assert bpy.ops.clay.hand_add(**options) == {"FINISHED"}
    return hand_objects(studio.scene)[0]


@pytest.fixture(scope="module")
def unbound_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hand") / "unbound.blend"


@pytest.fixture
def unbound(studio: Any, unbound_file: Path) -> Any:
    """A selected rigged hand that is not a clay hand; from a file, to create it only once."""
    if not unbound_file.exists():
        item = added(studio, side="RIGHT")
        studio.select(item)
        assert bpy.ops.clay.hand_remove() == {"FINISHED"}
        studio.save(unbound_file.parent, unbound_file.name)
    bpy.ops.wm.open_mainfile(filepath=str(unbound_file))
    item = bpy.data.objects["Right hand"]
    studio.select(item)
    return item


def test_both_hands_are_added_thumb_to_thumb(studio: Any) -> None:
    """Add a left and a right hand on both sides of the cursor; the last armature is active."""
    studio.scene.cursor.location = (1.0, 2.0, 3.0)
    assert bpy.ops.clay.hand_add(side="BOTH", length=0.16) == {"FINISHED"}
    left, right = hand_objects(studio.scene)
    assert (left.name, right.name) == ("Left hand", "Right hand")
    assert left.parent.location.x < 1.0 < right.parent.location.x
    thumbs = [
        (item.parent.matrix_world @ item.parent.data.bones["thumb_tip"].matrix_local).translation
        for item in (left, right)
    ]
    assert left.parent.location.x < thumbs[0].x < thumbs[1].x < right.parent.location.x
    assert (thumbs[0] - Vector((1.0, 2.0, 3.0))).length < 0.16
    assert bpy.context.object == right.parent
    bones = right.parent.pose.bones
    assert all(bone.custom_shape is not None for bone in bones)
    # The custom shape of a bone ends where the next bone begins.
    end = bones["index_proximal"].matrix @ Vector(
        (0.0, 0.0, -bones["index_proximal"].custom_shape_scale_xyz[2])
    )
    assert (end - bones["index_intermediate"].head).length < 1e-5


def test_adding_is_undone(studio: Any) -> None:
    """Remove hand and armature with one Undo."""
    bpy.ops.ed.undo_push(message="empty")
    added(studio)
    bpy.ops.ed.undo_push(message="hand")
    bpy.ops.ed.undo()
    assert list(bpy.context.scene.objects) == []
    bpy.ops.ed.redo()
    (item,) = hand_objects(bpy.context.scene)
    assert is_stored(item.data)


def test_hand_is_made_from_mesh_or_armature(studio: Any, unbound: Any) -> None:
    """Bind the selected mesh, or the mesh of the selected armature; then remove the binding."""
    item = unbound
    assert not is_stored(item.data)
    for chosen in (item, item.parent):
        studio.select(chosen)
        assert bpy.ops.clay.hand_make() == {"FINISHED"}
        assert hand_objects(studio.scene) == [item]
        assert is_stored(item.data)
        assert bpy.ops.clay.hand_remove() == {"FINISHED"}
        assert hand_objects(studio.scene) == []


def test_empty_selection_is_refused(studio: Any) -> None:
    """Say that nothing, or no hand, is selected."""
    assert "Nothing is selected" in studio.refused(bpy.ops.clay.hand_make)
    studio.block()
    assert "No clay hand is selected" in studio.refused(bpy.ops.clay.hand_remove)


def test_mesh_without_armature_is_refused(studio: Any) -> None:
    """Ask for an armature."""
    studio.block()
    assert "'Cube' is not rigged" in studio.refused(bpy.ops.clay.hand_make)
    bpy.ops.object.empty_add()
    assert "'Empty' is not a mesh (empty)" in studio.refused(bpy.ops.clay.hand_make)


def delete_faces(item: Any) -> None:
    mesh = bmesh.new()
    mesh.from_mesh(item.data)
    mesh.faces.ensure_lookup_table()
    bmesh.ops.delete(mesh, geom=[mesh.faces[5], mesh.faces[3000]], context="FACES_ONLY")
    mesh.to_mesh(item.data)
    mesh.free()


def flip_faces(item: Any) -> None:
    item.data.flip_normals()


def add_ring(item: Any) -> None:
    mesh = bmesh.new()
    mesh.from_mesh(item.data)
    bmesh.ops.create_cube(mesh, size=0.01)
    mesh.to_mesh(item.data)
    mesh.free()


def unweight(item: Any) -> None:
    for group in item.vertex_groups:
        group.remove(list(range(12)))


def drop_groups(item: Any) -> None:
    item.vertex_groups.clear()


def make_infinite(item: Any) -> None:
    item.data.vertices[7].co.x = float("nan")


def second_armature(item: Any) -> None:
    other = bpy.data.objects.new("Other", bpy.data.armatures.new("Other"))
    bpy.context.collection.objects.link(other)
    item.modifiers.new("Other", "ARMATURE").object = other


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (delete_faces, "open: it has 2 holes"),
        (flip_faces, "inside out"),
        (add_ring, "2 separate pieces"),
        (unweight, "12 of 3828 vertices without bone weights"),
        (drop_groups, "no vertex group named after a bone"),
        (make_infinite, "1 vertices that are not finite"),
        (second_armature, "has 2 armatures"),
    ],
)
def test_invalid_hand_is_refused(studio: Any, unbound: Any, change: Any, words: str) -> None:
    """Name the object and what is wrong with it, and change nothing."""
    item = unbound
    change(item)
    bpy.context.view_layer.update()
    studio.select(item)
    message = studio.refused(bpy.ops.clay.hand_make)
    assert words in message and "Right hand" in message
    assert item.tactile_clay.role == "NONE" and not is_stored(item.data)


def test_selection_with_an_unrigged_mesh_is_refused(studio: Any, unbound: Any) -> None:
    """Bind all selected meshes, or none."""
    block = studio.block()
    studio.select(unbound, block)
    assert "not rigged" in studio.refused(bpy.ops.clay.hand_make)
    assert unbound.tactile_clay.role == "NONE"


def twin(item: Any, *, linked: bool = False) -> Any:
    """A copy of a rigged hand with an armature of its own; its mesh is shared if linked."""
    armature, copy = item.parent.copy(), item.copy()
    armature.data = item.parent.data.copy()
    if not linked:
        copy.data = item.data.copy()
    copy.parent = armature
    for modifier in copy.modifiers:
        modifier.object = armature
    for new in (armature, copy):
        bpy.context.scene.collection.objects.link(new)
    armature.location.x += 1.0
    bpy.context.view_layer.update()
    return copy


def kept(item: Any) -> tuple[str, bytes]:
    """What Make Clay Hand writes into an object and its mesh."""
    return item.tactile_clay.role, bytes(item.data.get(PROPERTY, b""))


def lose_pose(item: Any) -> None:
    item.parent.pose.bones["index_distal"].location.x = float("nan")


@pytest.mark.parametrize("change", [delete_faces, flip_faces, add_ring, unweight, lose_pose])
@pytest.mark.parametrize("failing", [0, 1, 2])
@pytest.mark.parametrize("bound", [False, True], ids=["unbound", "bound"])
def test_all_selected_hands_are_bound_or_none(
    studio: Any, unbound: Any, change: Any, failing: int, bound: bool
) -> None:
    """Leave each hand as it was, bound before or not, when any of them cannot be bound."""
    hands = [unbound, twin(unbound), twin(unbound)]
    if bound:
        studio.select(*hands)
        assert bpy.ops.clay.hand_make() == {"FINISHED"}
        # Another binding would be another one than before.
        studio.scene.tactile_clay.spacing = 0.015
    change(hands[failing])
    bpy.context.view_layer.update()
    before = [kept(item) for item in hands]
    assert all((role == "HAND") == bound == bool(binding) for role, binding in before)
    studio.select(*hands)
    message = studio.refused(bpy.ops.clay.hand_make)
    assert hands[failing].name in message or hands[failing].parent.name in message
    assert [kept(item) for item in hands] == before


@pytest.mark.parametrize("scale", [1.0, 1.2])
def test_hands_that_share_a_mesh_share_its_binding_or_are_refused(
    studio: Any, unbound: Any, scale: float
) -> None:
    """Bind both where one binding fits both; else change nothing and say why."""
    other = twin(unbound, linked=True)
    other.parent.scale = (scale,) * 3
    bpy.context.view_layer.update()
    studio.select(unbound, other)
    if scale == 1.0:
        assert bpy.ops.clay.hand_make() == {"FINISHED"}
        assert len(hand_objects(studio.scene)) == 2
    else:
        message = studio.refused(bpy.ops.clay.hand_make)
        assert "shares its mesh" in message and "its size has changed" in message
        assert hand_objects(studio.scene) == [] and not is_stored(unbound.data)


def test_hand_is_not_made_into_clay(studio: Any) -> None:
    """Refuse a hand as the source of clay, which would hide it."""
    item = added(studio, side="RIGHT")
    studio.select(item)
    assert "'Right hand' is a clay hand" in studio.refused(bpy.ops.clay.make)


def test_edited_hand_is_refused(studio: Any, unbound: Any) -> None:
    """Ask the user to leave Edit Mode."""
    bpy.ops.object.mode_set(mode="EDIT")
    assert "is being edited" in studio.refused(bpy.ops.clay.hand_make)
    assert "only be added in Object Mode" in studio.refused(bpy.ops.clay.hand_add)
    bpy.ops.object.mode_set(mode="OBJECT")


def test_linked_hand_is_refused(studio: Any, unbound: Any, unbound_file: Path) -> None:
    """Refuse a linked mesh, whose binding would not be saved."""
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(unbound_file), link=True) as (_, loaded):
        loaded.objects = ["Right hand"]
    (linked,) = loaded.objects
    bpy.context.scene.collection.objects.link(linked)
    bpy.context.scene.collection.objects.link(linked.parent)
    bpy.context.view_layer.update()
    studio.select(linked)
    assert "linked from another file" in studio.refused(bpy.ops.clay.hand_make)


def test_panel_lists_hands_and_their_problems(studio: Any) -> None:
    """List the hands, with a message for one that has changed."""
    item = added(studio)

    def drawn() -> str:
        from tactile_clay.clay_addon import panel

        panel._hand_states.clear()
        layout = Layout([])
        layout.operator_menu_enum = lambda *_, **__: None  # type: ignore[attr-defined]
        CLAY_PT_hands.draw(SimpleNamespace(layout=layout), bpy.context)  # type: ignore[arg-type]
        return " ".join(layout.texts)

    assert "Right hand" in drawn() and "changed" not in drawn()
    item.data.vertices[0].co.x += 0.01
    assert "has changed since it was bound" in drawn()
