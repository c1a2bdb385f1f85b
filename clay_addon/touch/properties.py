# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of touch saved in a .blend: ``Scene.tactile_touch`` and ``Object.tactile_touch``."""

import tomllib
from pathlib import Path

import bpy

from ..base.overridable import overridable

_PRESETS = Path(__file__).parents[2] / "presets" / "arrays"

# A .blend stores the number, so a number must never get another meaning.
_KINDS = (
    ("SIMULATED", "Simulated", "A simulated array, to preview touch without hardware", 0),
    ("SONICSURFACE", "SonicSurface", "Connected to a serial port", 1),
    ("ULTRAINO", "Ultraino", "Connected to a serial port", 2),
    ("OPENMPD", "OpenMPD", "Connected by USB", 3),
    ("AUTD3", "AUTD3", "Connected by Ethernet", 4),
    ("STRATOS_EXPLORE", "STRATOS Explore", "Through a bridge built with Ultraleap's SDK", 5),
    ("SERVER", "Running Server", "The device of a `tactile-clay array-server` already running", 6),
)


def _array_items() -> list[tuple[str, str, str, str, int]]:
    numbers = {name.lower(): number for name, _, _, number in _KINDS}
    items: list[tuple[str, str, str, str, int]] = []
    for path in sorted(_PRESETS.glob("*.toml")):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        number = numbers.get(path.stem, 100 + len(items))
        items.append((path.stem, table["label"], table["description"], "NONE", number))
    return items


ARRAY_ITEMS = _array_items()
"""Enum items of the array presets."""


def is_array(item: bpy.types.Object) -> bool:
    """Whether an object represents an ultrasound array."""
    return bool(item.tactile_touch.is_array)


@overridable
class ClayTouchObjectProperties(bpy.types.PropertyGroup):
    """Touch properties of an object."""

    is_array: bpy.props.BoolProperty(name="Ultrasound Array", default=False)
    preset: bpy.props.EnumProperty(
        name="Array", description="Model of the array at this object", items=ARRAY_ITEMS
    )


class ClayTouchSceneProperties(bpy.types.PropertyGroup):
    """Touch settings of a scene."""

    array: bpy.props.PointerProperty(
        name="Array",
        description="Object at the position and rotation of the real array",
        type=bpy.types.Object,
        poll=lambda self, item: is_array(item),
    )
    kind: bpy.props.EnumProperty(
        name="Device",
        description="The connected ultrasound array",
        items=[(name, label, text, "NONE", number) for name, label, text, number in _KINDS],
        default="SIMULATED",
    )
    port: bpy.props.StringProperty(
        name="Port",
        description="Serial port, such as /dev/ttyUSB0 or COM3; empty to use the only one",
    )
    board_file: bpy.props.StringProperty(
        name="Board File", description="The board_N.pat file of the board", subtype="FILE_PATH"
    )
    interface: bpy.props.StringProperty(
        name="Interface", description="Network interface, or HOST:PORT of an emulator"
    )
    bridge: bpy.props.StringProperty(
        name="Bridge", description="The bridge program, built with the SDK", subtype="FILE_PATH"
    )
    server_port: bpy.props.IntProperty(
        name="Port",
        description="Port of the array server on this machine",
        default=17717,
        min=1,
        max=65535,
    )
    firmware: bpy.props.EnumProperty(
        name="Firmware",
        items=(
            ("stock", "Stock", "Modulated by the host, 30 frames per second"),
            ("tactile", "Tactile", "Modulated by the board, 88 frames per second"),
        ),
    )
    board: bpy.props.EnumProperty(
        name="Board",
        items=(
            ("mega", "Arduino Mega", "64 outputs"),
            ("fpga", "FPGA", "256 outputs, 32 phases"),
            ("fpga128", "FPGA 128", "72 outputs, 128 phases"),
        ),
    )
    gain: bpy.props.FloatProperty(
        name="Gain",
        description="Focal pressure relative to the pressure of the clay, for a light touch",
        default=0.04,
        min=1e-4,
        soft_max=1.0,
        precision=3,
    )
    ceiling: bpy.props.FloatProperty(
        name="Ceiling (Pa)",
        description="Maximum pressure at a focal point [Pa]",
        default=1000.0,
        min=1.0,
        max=2000.0,
        precision=0,
    )
    use_weights: bpy.props.BoolProperty(
        name="Skin Sensitivity",
        description="Prefer focal points where the skin is most sensitive",
        default=True,
    )
    focus_count: bpy.props.IntProperty(
        name="Focal Points",
        description="Maximum number of focal points",
        default=8,
        min=1,
        max=32,
    )
    modulation: bpy.props.EnumProperty(
        name="Modulation",
        items=(
            ("AMPLITUDE", "200 Hz", "On and off at 200 Hz, where skin is most sensitive"),
            ("NONE", "Steady", "Constant pressure for measurements, barely perceptible"),
        ),
    )
    show_overlay: bpy.props.BoolProperty(
        name="Overlay",
        description="Show focal points and their pressure on the skin",
        default=True,
    )
    play_baked: bpy.props.BoolProperty(
        name="Feel the Bake",
        description="Send the recorded focal points during playback of the bake",
        default=True,
    )


def device_name(properties: ClayTouchSceneProperties) -> str:
    """Name of the chosen device for the array server; if simulated, of the scene's array."""
    kind = properties.kind
    if kind == "SIMULATED":
        preset = properties.array.tactile_touch.preset if properties.array else ""
        return f"simulated:{preset}" if preset else "simulated"
    address, options = "", ""
    if kind == "SONICSURFACE":
        address, options = properties.port, f",firmware={properties.firmware}"
    elif kind == "ULTRAINO":
        address, options = properties.port, f",board={properties.board}"
    elif kind == "OPENMPD":
        address = bpy.path.abspath(properties.board_file)
    elif kind == "AUTD3":
        address = properties.interface
    else:
        address = bpy.path.abspath(properties.bridge)
    return f"{kind.lower()}:{address}{options}"


_CLASSES = (ClayTouchObjectProperties, ClayTouchSceneProperties)


def register() -> None:
    """Register the property groups, and add them to objects and scenes."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Object.tactile_touch = bpy.props.PointerProperty(
        type=ClayTouchObjectProperties, override={"LIBRARY_OVERRIDABLE"}
    )
    bpy.types.Scene.tactile_touch = bpy.props.PointerProperty(type=ClayTouchSceneProperties)


def unregister() -> None:
    """Remove the property groups; values saved in .blend files remain there."""
    del bpy.types.Scene.tactile_touch
    del bpy.types.Object.tactile_touch
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
