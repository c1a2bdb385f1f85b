# SPDX-License-Identifier: GPL-3.0-or-later
"""What a .blend keeps about touch: ``Scene.tactile_touch`` and ``Object.tactile_touch``."""

import tomllib
from pathlib import Path

import bpy

from ..base.overridable import overridable

_PRESETS = Path(__file__).parents[2] / "presets" / "arrays"

# A .blend keeps the number, so none may be used for anything else later.
_KINDS = (
    ("SIMULATED", "Simulated", "An array that is not there: to see what would be felt", 0),
    ("SONICSURFACE", "SonicSurface", "On a serial port", 1),
    ("ULTRAINO", "Ultraino", "On a serial port", 2),
    ("OPENMPD", "OpenMPD", "On USB", 3),
    ("AUTD3", "AUTD3", "On Ethernet", 4),
    ("STRATOS_EXPLORE", "STRATOS Explore", "Through a bridge built against Ultraleap's SDK", 5),
    ("SERVER", "Running Server", "Whatever `tactile-clay array-server` was started for by hand", 6),
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
"""The arrays that there are presets of."""


def is_array(item: bpy.types.Object) -> bool:
    """Whether an object stands for an ultrasound array."""
    return bool(item.tactile_touch.is_array)


@overridable
class ClayTouchObjectProperties(bpy.types.PropertyGroup):
    """What an object is to touch."""

    is_array: bpy.props.BoolProperty(name="Ultrasound Array", default=False)
    preset: bpy.props.EnumProperty(
        name="Array", description="Which array stands here", items=ARRAY_ITEMS
    )


class ClayTouchSceneProperties(bpy.types.PropertyGroup):
    """How the clay of a scene is felt."""

    array: bpy.props.PointerProperty(
        name="Array",
        description="The object that stands where the array stands",
        type=bpy.types.Object,
        poll=lambda self, item: is_array(item),
    )
    kind: bpy.props.EnumProperty(
        name="Device",
        description="The ultrasound array that is plugged in",
        items=[(name, label, text, "NONE", number) for name, label, text, number in _KINDS],
        default="SIMULATED",
    )
    port: bpy.props.StringProperty(
        name="Port",
        description="Serial port, as /dev/ttyUSB0 or COM3; empty where only one is plugged in",
    )
    board_file: bpy.props.StringProperty(
        name="Board File", description="The board's own board_N.pat", subtype="FILE_PATH"
    )
    interface: bpy.props.StringProperty(
        name="Interface", description="Network interface, or HOST:PORT of an emulator"
    )
    bridge: bpy.props.StringProperty(
        name="Bridge", description="The bridge program, built against the SDK", subtype="FILE_PATH"
    )
    server_port: bpy.props.IntProperty(
        name="Port",
        description="Where the array server listens on this machine",
        default=17717,
        min=1,
        max=65535,
    )
    firmware: bpy.props.EnumProperty(
        name="Firmware",
        items=(
            ("stock", "Stock", "Modulated by exchanges: 30 frames a second"),
            ("tactile", "Tactile", "Modulates by itself: 88 frames a second"),
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
        description="Pressure that is felt over pressure of the clay, for a light touch",
        default=0.04,
        min=1e-4,
        soft_max=1.0,
        precision=3,
    )
    ceiling: bpy.props.FloatProperty(
        name="Ceiling (Pa)",
        description="Pressure at a focal point that is never exceeded [Pa]",
        default=1000.0,
        min=1.0,
        max=2000.0,
        precision=0,
    )
    use_weights: bpy.props.BoolProperty(
        name="Skin Sensitivity",
        description="Put focal points where the skin feels best",
        default=True,
    )
    focus_count: bpy.props.IntProperty(
        name="Focal Points", description="Most focal points at a time", default=8, min=1, max=32
    )
    modulation: bpy.props.EnumProperty(
        name="Modulation",
        items=(
            ("AMPLITUDE", "200 Hz", "On and off at 200 Hz, which skin feels best"),
            ("NONE", "Steady", "A steady pressure, for measuring: it is hardly felt"),
        ),
    )
    show_overlay: bpy.props.BoolProperty(
        name="Overlay",
        description="Show focal points, and the pressure they give on the skin",
        default=True,
    )
    play_baked: bpy.props.BoolProperty(
        name="Feel the Bake",
        description="Send the focal points that were recorded with the bake while it plays",
        default=True,
    )


def device_name(properties: ClayTouchSceneProperties) -> str:
    """The chosen device, as the array server reads it; a simulated one is of the scene's array."""
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
    """Register the property groups and hang them on objects and scenes."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Object.tactile_touch = bpy.props.PointerProperty(
        type=ClayTouchObjectProperties, override={"LIBRARY_OVERRIDABLE"}
    )
    bpy.types.Scene.tactile_touch = bpy.props.PointerProperty(type=ClayTouchSceneProperties)


def unregister() -> None:
    """Take the property groups away; what a .blend keeps stays in it."""
    del bpy.types.Scene.tactile_touch
    del bpy.types.Object.tactile_touch
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
