# SPDX-License-Identifier: GPL-3.0-or-later
"""The sculpting brush of a scene: ``Scene.tactile_clay_sculpt``."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ..base.app_handlers import add_handlers, remove_handlers
from ..base.later import later
from ..base.units import from_meters, meters_per_unit
from ..core.brush.adjust import Adjusted
from ..core.tools.presets import ToolPreset, ToolPresetError
from ..core.tools.settings import BrushSettings
from ..core.tools.tools import BY_IDENTIFIER, tool_items
from ..model.clay_scene import clay_objects
from .live.current import current
from .tool_stamp import stamp_from_object

_RADIUS = 0.012
"""Default radius [m]."""


def _get_radius(properties: Any) -> float:
    # The size of a fingertip at any unit scale, until a value is set.
    return properties.radius_chosen or from_meters(properties.id_data, _RADIUS)


def _set_radius(properties: Any, value: float) -> None:
    properties.radius_chosen = value


def _is_mesh(properties: Any, item: bpy.types.Object) -> bool:
    return bool(item.type == "MESH")


class ClaySculptProperties(bpy.types.PropertyGroup):
    """The brush of a scene. Lengths are in Blender units."""

    tool: bpy.props.EnumProperty(
        name="Tool",
        description="What the mouse does to the clay",
        items=tool_items(),
        default="FINGER",
    )
    radius: bpy.props.FloatProperty(
        name="Radius",
        description="Size of the tool (F)",
        subtype="DISTANCE",
        unit="LENGTH",
        min=1e-6,
        soft_min=1e-3,
        precision=4,
        step=0.1,
        get=_get_radius,
        set=_set_radius,
    )
    radius_chosen: bpy.props.FloatProperty(options={"HIDDEN"})
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="How deep the tool goes, or how much paint it applies (Shift F)",
        subtype="FACTOR",
        default=0.5,
        min=0.0,
        max=1.0,
    )
    use_pressure: bpy.props.BoolProperty(
        name="Pressure",
        description="Pen pressure affects the strength",
        default=True,
    )
    mirror_x: bpy.props.BoolProperty(
        name="X", description="Mirror strokes about the clay's YZ plane"
    )
    mirror_y: bpy.props.BoolProperty(
        name="Y", description="Mirror strokes about the clay's XZ plane"
    )
    mirror_z: bpy.props.BoolProperty(
        name="Z", description="Mirror strokes about the clay's XY plane"
    )
    color: bpy.props.FloatVectorProperty(
        name="Color",
        description="Color of paint and added clay",
        subtype="COLOR",
        size=3,
        min=0.0,
        max=1.0,
        default=(0.72, 0.36, 0.22),
    )
    stamp: bpy.props.PointerProperty(
        name="Stamp",
        description="Closed mesh whose underside is pressed into the clay",
        type=bpy.types.Object,
        poll=_is_mesh,
    )


class SceneSource:
    """Reads a brush's settings from a scene, and writes radius and strength back.

    Args:
        scene: The scene; looked up by name each time, as Undo replaces the object.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self._name = scene.name
        self._stamp: tuple[str, ToolPreset | None] = ("", None)
        self._last = BrushSettings()

    def read(self) -> BrushSettings:
        """The current settings; the last ones if the scene was deleted."""
        scene = bpy.data.scenes.get(self._name)
        if scene is None:
            return self._last
        properties = scene.tactile_clay_sculpt
        scale = meters_per_unit(scene)
        clay = clay_objects(scene)
        key, stamp = self._read_stamp(properties.stamp if properties.tool == "STAMP" else None)
        self._last = BrushSettings(
            tool=BY_IDENTIFIER[properties.tool],
            radius=properties.radius * scale,
            strength=properties.strength,
            use_pressure=properties.use_pressure,
            mirror=(properties.mirror_x, properties.mirror_y, properties.mirror_z),
            mirror_frame=mirror_frame(clay, scale),
            color=(*properties.color, 1.0),
            spacing=clay[0].tactile_clay.spacing * scale if clay else self._last.spacing,
            scale=scale,
            stamp=stamp,
            stamp_key=key,
        )
        return self._last

    def write(self, name: Adjusted, value: float) -> None:
        """Set the radius [m] or the strength."""
        scene = bpy.data.scenes.get(self._name)
        if scene is not None:
            if name == "radius":
                value = from_meters(scene, value)
            setattr(scene.tactile_clay_sculpt, name, value)

    def _read_stamp(self, item: bpy.types.Object | None) -> tuple[str, ToolPreset | None]:
        if item is None or item.type != "MESH":
            return "", None
        key = _stamp_key(item)
        if key != self._stamp[0]:
            try:
                preset = stamp_from_object(item, bpy.context.evaluated_depsgraph_get())
                self._stamp = (key, preset)
                _stamp_faults.pop(key, None)
            except ToolPresetError as error:
                # The default stamp is used instead.
                self._stamp = (key, None)
                _stamp_faults[key] = str(error)
        return self._stamp if self._stamp[1] is not None else ("", None)


_stamp_faults: dict[str, str] = {}
"""Why objects cannot be stamps, by `_stamp_key`."""


def _stamp_key(item: bpy.types.Object) -> str:
    scales = [round(value, 6) for value in item.matrix_world.to_scale()]
    return f"{item.name_full} {len(item.data.vertices)} {scales}"


def stamp_fault(item: bpy.types.Object | None) -> str:
    """Why an object cannot be a stamp; empty if it can be, or has not been tried yet."""
    if item is None or item.type != "MESH":
        return ""
    return _stamp_faults.get(_stamp_key(item), "")


def mirror_frame(clay: list[bpy.types.Object], scale: float) -> NDArray[np.float64]:
    """Matrix from the mirror frame to the world [m]: the active clay object's, or the first one's.

    Args:
        clay: The clay objects of a scene.
        scale: Length of a Blender unit [m].
    """
    if not clay:
        return np.eye(4)
    active = bpy.context.view_layer.objects.active if bpy.context.view_layer else None
    item = next((one for one in clay if one == active), clay[0])
    matrix = np.array(item.matrix_world, np.float64)
    axes, _ = np.linalg.qr(matrix[:3, :3])
    frame = np.eye(4)
    # The sign of an axis does not matter for a mirror.
    frame[:3, :3] = axes
    frame[:3, 3] = matrix[:3, 3] * scale
    return frame


_saved_brushes: dict[str, dict[str, Any]] = {}


@persistent
def _before_undo(*_: object) -> None:
    # Undo must not change the brush, as with Blender's own brushes.
    # If an earlier undo has not been handled yet, the brushes saved then still count.
    if current.session is not None and not _saved_brushes:
        for scene in bpy.data.scenes:
            properties = scene.tactile_clay_sculpt
            _saved_brushes[scene.name] = {
                name: _value(properties, name) for name in _SAVED_PROPERTIES
            }


@persistent
def _after_undo(*_: object) -> None:
    later.schedule(_restore_brushes)


def _restore_brushes() -> None:
    for scene_name, values in _saved_brushes.items():
        scene = bpy.data.scenes.get(scene_name)
        if scene is not None:
            for name, value in values.items():
                setattr(scene.tactile_clay_sculpt, name, value)
    _saved_brushes.clear()


def _value(properties: Any, name: str) -> Any:
    value = getattr(properties, name)
    return tuple(value) if name == "color" else value


_SAVED_PROPERTIES = (
    "tool", "radius_chosen", "strength", "use_pressure", "mirror_x", "mirror_y", "mirror_z", "color"
)  # fmt: skip
_HANDLERS = (
    ("undo_pre", _before_undo),
    ("redo_pre", _before_undo),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
)


def register() -> None:
    """Register the properties and add them to scenes."""
    add_handlers(_HANDLERS)
    bpy.utils.register_class(ClaySculptProperties)
    bpy.types.Scene.tactile_clay_sculpt = bpy.props.PointerProperty(type=ClaySculptProperties)


def unregister() -> None:
    """Remove the properties; the values in the .blend remain."""
    remove_handlers(_HANDLERS)
    del bpy.types.Scene.tactile_clay_sculpt
    bpy.utils.unregister_class(ClaySculptProperties)
