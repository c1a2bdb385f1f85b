# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of clay hands: what they make, what they refuse, and that Undo takes them back."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bmesh
import bpy
import pytest
from mathutils import Vector

from tactile_clay.clay_addon.hands.hand import hand_objects
from tactile_clay.clay_addon.hands.store import is_stored
from tactile_clay.clay_addon.panel import CLAY_PT_hands

from ..test_panel import Layout


@pytest.fixture(autouse=True)
def few_ghosts(studio: Any) -> None:
    """Clay so coarse that binding is quick."""
    studio.scene.tactile_clay.spacing = 0.02


def added(studio: Any, **options: Any) -> Any:
    assert bpy.ops.clay.hand_add(**options) == {"FINISHED"}
    return hand_objects(studio.scene)[0]


@pytest.fixture(scope="module")
def unbound_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hand") / "unbound.blend"


@pytest.fixture
def unbound(studio: Any, unbound_file: Path) -> Any:
    """A rigged hand that is no clay hand, selected; from a file, to make it only once."""
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
    """Add a left and a right hand beside the cursor, with the armature of the last one active."""
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
    # The shape of a bone ends where the next begins.
    end = bones["index_proximal"].matrix @ Vector(
        (0.0, 0.0, -bones["index_proximal"].custom_shape_scale_xyz[2])
    )
    assert (end - bones["index_intermediate"].head).length < 1e-5


def test_adding_is_undone(studio: Any) -> None:
    """Take hand and armature away with one Undo."""
    bpy.ops.ed.undo_push(message="empty")
    added(studio)
    bpy.ops.ed.undo_push(message="hand")
    bpy.ops.ed.undo()
    assert list(bpy.context.scene.objects) == []
    bpy.ops.ed.redo()
    (item,) = hand_objects(bpy.context.scene)
    assert is_stored(item.data)


def test_hand_is_made_from_mesh_or_armature(studio: Any, unbound: Any) -> None:
    """Bind the selected mesh, or that of the selected armature; remove it again."""
    item = unbound
    assert not is_stored(item.data)
    for chosen in (item, item.parent):
        studio.select(chosen)
        assert bpy.ops.clay.hand_make() == {"FINISHED"}
        assert hand_objects(studio.scene) == [item]
        assert is_stored(item.data)
        assert bpy.ops.clay.hand_remove() == {"FINISHED"}
        assert hand_objects(studio.scene) == []


def test_nothing_selected_is_said(studio: Any) -> None:
    """Say that nothing is selected, or no hand."""
    assert "Nothing is selected" in studio.refused(bpy.ops.clay.hand_make)
    studio.block()
    assert "No clay hand is selected" in studio.refused(bpy.ops.clay.hand_remove)


def test_mesh_without_armature_is_refused(studio: Any) -> None:
    """Ask for an armature."""
    studio.block()
    assert "'Cube' is not rigged" in studio.refused(bpy.ops.clay.hand_make)
    bpy.ops.object.empty_add()
    assert "'Empty' is no mesh (empty)" in studio.refused(bpy.ops.clay.hand_make)


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


def spoil(item: Any) -> None:
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
        (unweight, "12 of 3828 vertices that no bone carries"),
        (drop_groups, "no vertex group named like a bone"),
        (spoil, "1 vertices that are not finite"),
        (second_armature, "carried by 2 armatures"),
    ],
)
def test_bad_hand_is_refused(studio: Any, unbound: Any, change: Any, words: str) -> None:
    """Name the object and what is wrong with it, and change nothing."""
    item = unbound
    change(item)
    bpy.context.view_layer.update()
    studio.select(item)
    message = studio.refused(bpy.ops.clay.hand_make)
    assert words in message and "Right hand" in message
    assert item.tactile_clay.role == "NONE" and not is_stored(item.data)


def test_good_hand_is_not_made_beside_a_bad_one(studio: Any, unbound: Any) -> None:
    """Bind all that is selected, or nothing."""
    block = studio.block()
    studio.select(unbound, block)
    assert "not rigged" in studio.refused(bpy.ops.clay.hand_make)
    assert unbound.tactile_clay.role == "NONE"


def test_hand_is_not_made_into_clay(studio: Any) -> None:
    """Keep a hand from being hidden as the source of clay."""
    item = added(studio, side="RIGHT")
    studio.select(item)
    assert "'Right hand' is a clay hand" in studio.refused(bpy.ops.clay.make)


def test_edited_hand_is_refused(studio: Any, unbound: Any) -> None:
    """Ask to leave Edit Mode."""
    bpy.ops.object.mode_set(mode="EDIT")
    assert "is being edited" in studio.refused(bpy.ops.clay.hand_make)
    assert "Leave the present mode first" in studio.refused(bpy.ops.clay.hand_add)
    bpy.ops.object.mode_set(mode="OBJECT")


def test_linked_hand_is_refused(studio: Any, unbound: Any, unbound_file: Path) -> None:
    """Keep nothing in a file that would not be saved."""
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(unbound_file), link=True) as (_, here):
        here.objects = ["Right hand"]
    (linked,) = here.objects
    bpy.context.scene.collection.objects.link(linked)
    bpy.context.scene.collection.objects.link(linked.parent)
    bpy.context.view_layer.update()
    studio.select(linked)
    assert "linked from another file" in studio.refused(bpy.ops.clay.hand_make)


def test_panel_names_hands_and_what_is_wrong(studio: Any) -> None:
    """List the hands, with a sentence for one that has changed."""
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
