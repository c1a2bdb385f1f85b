# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials offered in the interface: shipped presets, the user's own, and custom values."""

from __future__ import annotations

import tomllib
from typing import Any

import bpy

from ...solver.scene.material import PRESET_FOLDER, Material
from .user_materials import material_number, user_materials

CUSTOM = "CUSTOM"
SCENE = "SCENE"
PRESET_DEFAULT = "plasticine"
PRESET_DEFAULT_NUMBER = material_number(PRESET_DEFAULT)
MISSING = "MISSING_"
"""Prefix of item names for presets that a .blend uses but this machine does not have."""

Item = tuple[str, str, str, str, int]

_items: dict[Item, Item] = {}
"""Every item ever shown: Blender keeps pointers to their strings, so none may be freed."""


def material_names() -> list[str]:
    """Names of all available presets, shipped ones first."""
    return [*Material.preset_names(), *(each.name for each in user_materials().materials)]


def find_material(name: str) -> Material:
    """The material of a shipped preset or one saved by the user.

    Raises:
        ValueError: There is no such preset; the message lists those available.
    """
    for own in user_materials().materials:
        if own.name == name:
            return own.material
    if name.startswith(MISSING):
        raise ValueError("The chosen material preset is not on this machine. Choose another.")
    if name not in Material.preset_names():
        known = ", ".join(material_names())
        raise ValueError(f"There is no material preset {name!r}. Available: {known}.")
    return Material.preset(name)


def is_user_material(name: str) -> bool:
    """Whether a preset was saved by the user, and so may be removed."""
    return any(each.name == name for each in user_materials().materials)


def object_items(properties: Any, context: bpy.types.Context | None) -> list[Item]:
    """Items for the material of a clay object."""
    custom = (CUSTOM, "Custom", "Values set below", "NONE", 0)
    return _interned([custom, *_preset_items(), *_missing_items(properties)])


def scene_items(properties: Any, context: bpy.types.Context | None) -> list[Item]:
    """Items for the material of new clay."""
    return _interned([*_preset_items(), *_missing_items(properties)])


def operator_items(properties: Any, context: bpy.types.Context | None) -> list[Item]:
    """Items for an operator that makes clay; the first uses the scene's material."""
    scene = (SCENE, "Scene", "The material set for the scene", "NONE", 0)
    return _interned([scene, *_preset_items()])


def _interned(items: list[Item]) -> list[Item]:
    return [_items.setdefault(item, item) for item in items]


def _preset_items() -> list[Item]:
    own = [
        (each.name, each.label, _values(each.material), "USER", material_number(each.name))
        for each in user_materials().materials
    ]
    return [*SHIPPED_ITEMS, *own]


def _shipped_items() -> list[Item]:
    items = []
    for name in Material.preset_names():
        table = tomllib.loads((PRESET_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
        description = f"{table['description']}. {_values(Material.preset(name))}"
        items.append((name, table["label"], description, "NONE", material_number(name)))
    return items


def _values(material: Material) -> str:
    return f"Density {material.density:g} kg/m³, yields at {material.yield_stress:g} Pa"


SHIPPED_ITEMS = _shipped_items()
"""Items of the shipped presets."""


def _missing_items(properties: Any) -> list[Item]:
    """An item for a number stored in the .blend that belongs to no available preset."""
    number = _stored_number(properties)
    known = {0, *(item[4] for item in SHIPPED_ITEMS)}
    if number is None or number in known:
        return []
    if any(material_number(each.name) == number for each in user_materials().materials):
        return []
    text = "A preset that is not on this machine; clay made of it keeps its values"
    return [(f"{MISSING}{number}", "Missing Preset", text, "ERROR", number)]


def _stored_number(properties: Any) -> int | None:
    # Reading the enum property itself would evaluate its items and recurse.
    if properties is None or not isinstance(properties, bpy.types.PropertyGroup):
        return None
    if hasattr(properties, "bl_system_properties_get"):
        properties = properties.bl_system_properties_get()
    return None if properties is None else properties.get("material_preset")
