# SPDX-License-Identifier: GPL-3.0-or-later
"""The *Clay* tab in the sidebar of the 3D view."""

from __future__ import annotations

import time

import bpy

from .bake.checks import changed_subjects
from .base.activity import ActivityKind, clay_activity
from .base.preferences import draw_missing_parts, draw_text
from .base.units import meters_per_unit
from .core.readable import duration_text, size_text
from .core.storage.cache import Cache, CacheError
from .hands.hand import hand_message, hand_objects
from .model.cache_folder import CacheFolderError, resolve_directory
from .model.clay_scene import SimulationError, clay_objects, collider_objects
from .model.digest import scene_digests
from .model.material_properties import draw_material
from .model.properties import frame_range
from .model.user_materials import user_material_folder, user_materials
from .playback import playback
from .playback.packed import is_packed

_GLANCE_SECONDS = 1.0
"""The state of the cache is looked at no more often than this [s]: a panel is drawn constantly."""

_glance: dict[str, tuple[float, str, str]] = {}
_hand_glance: dict[str, tuple[float, str]] = {}


class _ClayPanel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Clay"


class CLAY_PT_clay(_ClayPanel, bpy.types.Panel):  # noqa: N801
    """Making clay, and what it is made of."""

    bl_label = "Clay"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        if draw_missing_parts(layout):
            return
        scene = context.scene
        item = context.object
        column = layout.column()
        column.prop(scene.tactile_clay, "spacing")
        column.prop(scene.tactile_clay, "material_preset")
        column.operator("clay.make", icon="META_BALL")
        problems = user_materials().problems
        if problems:
            box = layout.box()
            for problem in problems:
                draw_text(box, problem, icon="ERROR")
            folder = str(user_material_folder())
            box.operator("wm.path_open", text="Open Folder", icon="FILE_FOLDER").filepath = folder
        # Convert turns clay into a mesh and leaves its role.
        if item is None or item.tactile_clay.role != "CLAY" or item.type != "POINTCLOUD":
            if not clay_objects(scene):
                draw_text(layout, "Select one or more closed meshes, then Make Clay.", icon="INFO")
            return
        clay = item.tactile_clay
        box = layout.box()
        box.label(text=item.name, icon="POINTCLOUD_DATA")
        box.label(
            text=f"{len(item.data.points):,} particles, {clay.spacing * 1e3:.3g} mm apart"
            if meters_per_unit(scene) == 1.0
            else f"{len(item.data.points):,} particles"
        )
        row = box.row(align=True)
        # Without its label there is room for the name.
        row.prop(clay, "material_preset", text="")
        row.operator("clay.material_save", text="", icon="ADD")
        row.operator("clay.material_remove", text="", icon="REMOVE")
        draw_material(box, clay)


class CLAY_PT_colliders(_ClayPanel, bpy.types.Panel):  # noqa: N801
    """What presses on the clay."""

    bl_label = "Colliders"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        row = layout.row(align=True)
        row.operator("clay.collider_add", icon="MOD_PHYSICS")
        row.operator("clay.collider_remove", text="", icon="X")
        for collider in collider_objects(context.scene):
            layout.label(text=collider.name, icon="MESH_DATA")
        item = context.object
        if item is not None and item.tactile_clay.role == "COLLIDER":
            box = layout.box()
            box.label(text=item.name)
            box.prop(item.tactile_clay, "collider_kind")
            box.prop(item.tactile_clay, "collider_enabled")
            box.prop(item.tactile_clay, "collider_friction")
            box.prop(item.tactile_clay, "collider_adhesion")
            # Decorated, as a pedal is there to be keyed.
            box.use_property_decorate = True
            box.prop(item.tactile_clay, "wheel_speed")


class CLAY_PT_hands(_ClayPanel, bpy.types.Panel):  # noqa: N801
    """Hands that work the clay."""

    bl_label = "Hands"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.operator_menu_enum("clay.hand_add", "side", icon="VIEW_PAN")
        row = layout.row(align=True)
        row.operator("clay.hand_make", icon="ARMATURE_DATA")
        row.operator("clay.hand_remove", text="", icon="X")
        for hand in hand_objects(context.scene):
            layout.label(text=hand.name, icon="VIEW_PAN")
            message = hand_state(context.scene, hand)
            if message:
                draw_text(layout.box(), message, icon="ERROR")
            # Whoever poses a hand has its armature active.
            if context.object is not None and context.object in (hand, hand.find_armature()):
                box = layout.box()
                box.use_property_split = True
                box.use_property_decorate = False
                box.prop(hand.tactile_clay, "collider_friction")


class CLAY_PT_bake(_ClayPanel, bpy.types.Panel):  # noqa: N801
    """The bake: its range, its folder, its state."""

    bl_label = "Bake"
    bl_order = 6

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        scene = context.scene
        properties = scene.tactile_clay
        column = layout.column()
        column.prop(properties, "use_scene_range")
        if not properties.use_scene_range:
            column.prop(properties, "frame_start")
            column.prop(properties, "frame_end")
        column.prop(properties, "substeps")
        column.prop(properties, "motion_samples")
        if hand_objects(scene):
            column.prop(properties, "hands_give_way")
        column.prop(properties, "cache_directory")
        running = clay_activity.progress if clay_activity.kind is ActivityKind.BAKE else None
        if running is not None:
            layout.progress(
                factor=running.done / max(1, running.total),
                text=f"Frame {running.frame}: {duration_text(running.seconds_left)} left",
            )
            layout.label(text="Esc stops; what is baked is kept", icon="INFO")
            return
        row = layout.row(align=True)
        row.operator("clay.bake", icon="PHYSICS")
        row.operator("clay.resume", icon="PLAY")
        row.operator("clay.free", icon="TRASH")
        try:
            cache = Cache(resolve_directory(scene))
        except CacheFolderError as error:
            draw_text(layout, str(error), icon="INFO")
            return
        state, warning = cache_state(scene, cache)
        draw_text(layout, state, icon="INFO")
        if any(is_packed(item) for item in clay_objects(scene)):
            draw_text(layout, "Plays the frames packed in the .blend.", icon="PACKAGE")
            layout.operator("clay.unpack", icon="UGLYPACKAGE")
        else:
            layout.operator("clay.pack", icon="PACKAGE")
        for text in (warning, playback.message(scene)):
            if text:
                draw_text(layout.box(), text, icon="ERROR")


class CLAY_PT_export(_ClayPanel, bpy.types.Panel):  # noqa: N801
    """Taking the shape out of Blender."""

    bl_label = "Export"
    bl_order = 8

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only once there is clay to export."""
        return bool(clay_objects(context.scene))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        self.layout.operator("clay.export", icon="EXPORT")


def hand_state(scene: bpy.types.Scene, hand: bpy.types.Object) -> str:
    """What is wrong with a hand, in words; looked up once a second."""
    known = _hand_glance.get(hand.name_full)
    if known is not None and time.monotonic() - known[0] < _GLANCE_SECONDS:
        return known[1]
    message = hand_message(scene, hand)
    _hand_glance[hand.name_full] = (time.monotonic(), message)
    return message


def cache_state(scene: bpy.types.Scene, cache: Cache) -> tuple[str, str]:
    """What the cache holds, and what is wrong with it, in words; looked up once a second."""
    known = _glance.get(scene.name)
    if known is not None and time.monotonic() - known[0] < _GLANCE_SECONDS:
        return known[1], known[2]
    frames = cache.frames()
    warning = ""
    if not frames:
        state = "Not baked yet."
    else:
        start, end = frame_range(scene)
        inside = [frame for frame in frames if start <= frame <= end]
        state = (
            f"{len(inside)} of {end + 1 - start} frames baked, {size_text(cache.size())} on disk."
        )
        try:
            # Colliders are not looked at: evaluating them takes too long for a panel.
            meta = cache.meta()
            if meta.is_take:
                state = f"A recorded take of {len(frames)} frames, {size_text(cache.size())}."
            changed = changed_subjects(meta, scene_digests(scene))
            if changed:
                warning = (
                    f"The bake is stale: the scene has changed: {', '.join(changed)}. Bake again."
                )
        except CacheError as error:
            warning = f"The cache cannot be used: {error}. Bake again."
        except SimulationError as error:
            warning = str(error)
    _glance[scene.name] = (time.monotonic(), state, warning)
    return state, warning


_CLASSES = (CLAY_PT_clay, CLAY_PT_colliders, CLAY_PT_hands, CLAY_PT_bake, CLAY_PT_export)


def register() -> None:
    """Register the panels."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the panels."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    _glance.clear()
    _hand_glance.clear()
