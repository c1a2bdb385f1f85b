# SPDX-License-Identifier: GPL-3.0-or-later
"""What a .blend keeps about its clay: ``Object.tactile_clay`` and ``Scene.tactile_clay``."""

from typing import Any

import bpy

from ..base.signals import held_frames_changed, wheels_changed
from ..base.units import from_meters
from .material_presets import (
    CUSTOM,
    MISSING,
    PRESET_DEFAULT_NUMBER,
    find_material,
    object_items,
    scene_items,
)
from .material_properties import property_declarations, write_material

MAX_WHEEL_SPEED = 400.0
"""Highest speed of a potter's wheel, either way [rpm]: more than any has, and less than half a turn
in the longest step of a live session."""


class _PresetFill:
    """Whether values are being set by a preset, which does not make them custom."""

    active = False


def _fill_from_preset(properties: Any, context: bpy.types.Context) -> None:
    name = properties.material_preset
    if name == CUSTOM or name.startswith(MISSING):
        return
    material = find_material(name)
    _PresetFill.active = True
    try:
        write_material(properties, material)
    finally:
        _PresetFill.active = False


def _become_custom(properties: Any, context: bpy.types.Context) -> None:
    if not _PresetFill.active and properties.material_preset != CUSTOM:
        properties.material_preset = CUSTOM


def _show_held(properties: Any, context: bpy.types.Context) -> None:
    held_frames_changed.send(properties.id_data)


def _tag_object(properties: Any, context: bpy.types.Context) -> None:
    # Values of add-ons do not reach the evaluated object by themselves.
    properties.id_data.update_tag()


def _set_wheels(properties: Any, context: bpy.types.Context) -> None:
    _tag_object(properties, context)
    wheels_changed.send(context.scene)


def _get_spacing(properties: Any) -> float:
    # Half a centimeter whatever the scene's unit scale, until a value is chosen.
    return properties.spacing_chosen or from_meters(properties.id_data, 0.005)


def _set_spacing(properties: Any, value: float) -> None:
    properties.spacing_chosen = value


class ClaySource(bpy.types.PropertyGroup):
    """A mesh that clay was made from."""

    source: bpy.props.PointerProperty(name="Source", type=bpy.types.Object)


class _MaterialValues:
    """The values of a material, made from the solver's table of them."""

    __annotations__ = property_declarations(_become_custom)


class ClayObjectProperties(_MaterialValues, bpy.types.PropertyGroup):
    """What an object is to the clay. Lengths are in Blender units, all else in SI units."""

    role: bpy.props.EnumProperty(
        name="Role",
        items=(
            ("NONE", "None", "Nothing to do with clay"),
            ("CLAY", "Clay", "A point cloud of clay particles"),
            ("COLLIDER", "Collider", "A mesh that presses on the clay"),
            ("HAND", "Hand", "A rigged hand that works the clay"),
        ),
        default="NONE",
    )
    material_preset: bpy.props.EnumProperty(
        name="Material",
        description="What the clay is made of; choosing one fills in the values below",
        items=object_items,
        default=PRESET_DEFAULT_NUMBER,
        update=_fill_from_preset,
    )
    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between particles; fixed when the clay is made",
        subtype="DISTANCE",
        unit="LENGTH",
        default=0.0,
        min=0.0,
        precision=4,
    )
    sources: bpy.props.CollectionProperty(
        name="Sources", description="The meshes the clay was made from", type=ClaySource
    )
    take_start: bpy.props.PointerProperty(
        name="Take Start",
        description="The clay that the last take began with",
        type=bpy.types.Mesh,
    )
    collider_kind: bpy.props.EnumProperty(
        name="Shape",
        description="How the clay meets this object",
        items=(
            ("AUTO", "Automatic", "A flat mesh is an infinite plane, any other a closed mesh"),
            ("MESH", "Closed mesh", "The mesh itself; it may move and deform"),
            ("PLANE", "Infinite plane", "An infinite plane through a flat mesh; it cannot move"),
        ),
        default="AUTO",
    )
    collider_enabled: bpy.props.BoolProperty(
        name="Touches Clay",
        description="Whether the clay feels this object; keyframes can lift a tool off and set it",
        default=True,
        update=_tag_object,
    )
    collider_friction: bpy.props.FloatProperty(
        name="Friction",
        description="Coulomb friction coefficient; a contact takes the geometric mean of both",
        default=0.5,
        min=0.0,
        soft_max=1.0,
    )
    collider_adhesion: bpy.props.FloatProperty(
        name="Adhesion (Pa)",
        description=(
            "Stress at which clay that has touched this object comes off again [Pa]: wet clay "
            "sticks to a wheel head with some thousand, to a dry tool with none"
        ),
        default=0.0,
        min=0.0,
        soft_max=20000.0,
    )
    wheel_speed: bpy.props.FloatProperty(
        name="Wheel Speed (rpm)",
        description=(
            "Turns a minute about the object's own Z axis, as a potter's wheel; keyframes or a "
            "driver work its pedal"
        ),
        default=0.0,
        min=-MAX_WHEEL_SPEED,
        max=MAX_WHEEL_SPEED,
        soft_min=0.0,
        soft_max=200.0,
        update=_set_wheels,
    )
    wheel_phase: bpy.props.FloatProperty(
        name="Wheel Phase",
        description="How far the wheel is turned at the first frame",
        subtype="ANGLE",
        update=_set_wheels,
    )
    wheel_axle: bpy.props.PointerProperty(
        name="Axle", description="What turns this wheel", type=bpy.types.Object, options={"HIDDEN"}
    )


class ClaySceneProperties(bpy.types.PropertyGroup):
    """How the clay of a scene is made and baked."""

    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description=(
            "Distance between the particles of new clay: half as much shows twice the detail and "
            "takes about ten times as long"
        ),
        subtype="DISTANCE",
        unit="LENGTH",
        min=1e-6,
        soft_min=1e-4,
        precision=4,
        get=_get_spacing,
        set=_set_spacing,
    )
    spacing_chosen: bpy.props.FloatProperty(options={"HIDDEN"})
    material_preset: bpy.props.EnumProperty(
        name="Material",
        description="What new clay is made of",
        items=scene_items,
        default=PRESET_DEFAULT_NUMBER,
    )
    substeps: bpy.props.IntProperty(
        name="Substeps",
        description="Solver steps in each sixtieth of a second; 0 takes the solver's own choice",
        default=0,
        min=0,
        max=4096,
    )
    motion_samples: bpy.props.IntProperty(
        name="Motion Samples",
        description=(
            "How often in each frame a bake looks where hands and colliders are: more follows what "
            "turns back between two frames, and recorded takes"
        ),
        default=1,
        min=1,
        max=64,
    )
    hands_give_way: bpy.props.BoolProperty(
        name="Hands Give Way",
        description="Stiff clay stops hands in a bake as it does live; off, they go where keyed",
        default=False,
    )
    record_take: bpy.props.BoolProperty(
        name="Record Take",
        description="Record what hands, tools and clay do while you sculpt, for the timeline",
        default=False,
    )
    take_edits: bpy.props.StringProperty(options={"HIDDEN"})
    film_edits: bpy.props.StringProperty(options={"HIDDEN"})
    film_of: bpy.props.PointerProperty(
        name="Film of",
        description="The scene whose take this one bakes again",
        type=bpy.types.Scene,
    )
    cache_directory: bpy.props.StringProperty(
        name="Cache",
        description="Folder of the bake; // is the folder of the .blend file",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        default="//clay_cache",
    )
    delivery_directory: bpy.props.StringProperty(
        name="Folder",
        description="Folder of the delivered files; // is the folder of the .blend file",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        default="//clay_delivery",
    )
    delivery_kind: bpy.props.EnumProperty(
        name="Format",
        description="What is written, and played in place of the clay",
        items=(
            ("usd", "USD", "Surface, colors and velocities, so that there is motion blur"),
            ("abc", "Alembic", "Surface and colors of eight bits; no motion blur"),
        ),
        default="usd",
    )
    delivery_points: bpy.props.BoolProperty(
        name="Particles Too",
        description="Write the particles beside the surface, for other programs (USD only)",
        default=False,
    )
    use_scene_range: bpy.props.BoolProperty(
        name="Scene Range",
        description="Bake the frame range of the scene",
        default=True,
    )
    frame_start: bpy.props.IntProperty(
        name="Start", description="First frame: the clay as it was made", default=1
    )
    frame_end: bpy.props.IntProperty(name="End", description="Last frame to bake", default=250)
    hold_frames: bpy.props.IntProperty(
        name="Hold",
        description=(
            "Frames that each simulated shape is held for: 1 shows all, 2 animates on twos. The "
            "simulation itself stays as it is"
        ),
        default=1,
        min=1,
        soft_max=8,
        update=_show_held,
    )


def frame_range(scene: bpy.types.Scene) -> tuple[int, int]:
    """First and last frame to bake."""
    properties = scene.tactile_clay
    if properties.use_scene_range:
        return scene.frame_start, scene.frame_end
    return properties.frame_start, properties.frame_end


_CLASSES = (ClaySource, ClayObjectProperties, ClaySceneProperties)


def register() -> None:
    """Register the property groups and hang them on objects and scenes."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Object.tactile_clay = bpy.props.PointerProperty(type=ClayObjectProperties)
    bpy.types.Scene.tactile_clay = bpy.props.PointerProperty(type=ClaySceneProperties)


def unregister() -> None:
    """Take the property groups away; what a .blend keeps stays in it."""
    del bpy.types.Scene.tactile_clay
    del bpy.types.Object.tactile_clay
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
