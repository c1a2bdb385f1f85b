# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials that the interface offers: those that ship, the user's own, and custom values."""

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
"""How the names of presets begin that a .blend names and this machine has not."""

Item = tuple[str, str, str, str, int]

_kept: dict[Item, Item] = {}
"""Blender holds on to the texts of items, so that none that was ever shown may be let go."""


def material_names() -> list[str]:
    """Names of all presets that are there, those that ship first."""
    return [*Material.preset_names(), *(each.name for each in user_materials().materials)]


def find_material(name: str) -> Material:
    """The material of a preset that ships or that the user has saved.

    Raises:
        ValueError: There is no such preset; the message says which there are.
    """
    for own in user_materials().materials:
        if own.name == name:
            return own.material
    if name.startswith(MISSING):
        raise ValueError(
            "The material preset that is chosen here is not on this machine. Choose another."
        )
    if name not in Material.preset_names():
        known = ", ".join(material_names())
        raise ValueError(f"There is no material preset {name!r}. There are: {known}.")
    return Material.preset(name)


def is_user_material(name: str) -> bool:
    """Whether a preset is one that the user has saved, and may remove."""
    return any(each.name == name for each in user_materials().materials)


def object_items(properties: Any, context: bpy.types.Context | None) -> list[Item]:
    """Items for what a clay object is made of."""
    custom = (CUSTOM, "Custom", "Values of your own", "NONE", 0)
    return _keep([custom, *_preset_items(), *_missing_items(properties)])


def scene_items(properties: Any, context: bpy.types.Context | None) -> list[Item]:
    """Items for what new clay is made of."""
    return _keep([*_preset_items(), *_missing_items(properties)])


def operator_items(properties: Any, context: bpy.types.Context | None) -> list[Item]:
    """Items for an operator that makes clay: the scene's choice first."""
    scene = (SCENE, "Scene", "The material set for the scene", "NONE", 0)
    return _keep([scene, *_preset_items()])


def _keep(items: list[Item]) -> list[Item]:
    return [_kept.setdefault(item, item) for item in items]


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
"""Items of the presets that ship."""


def _missing_items(properties: Any) -> list[Item]:
    """An item for a number that stands in a .blend and belongs to no preset that is there."""
    number = _stored_number(properties)
    known = {0, *(item[4] for item in SHIPPED_ITEMS)}
    if number is None or number in known:
        return []
    if any(material_number(each.name) == number for each in user_materials().materials):
        return []
    text = "A preset that is not on this machine; clay that was made of it keeps its values"
    return [(f"{MISSING}{number}", "Missing Preset", text, "ERROR", number)]


def _stored_number(properties: Any) -> int | None:
    # Asking the property itself would ask for its items again.
    if properties is None or not isinstance(properties, bpy.types.PropertyGroup):
        return None
    if hasattr(properties, "bl_system_properties_get"):
        properties = properties.bl_system_properties_get()
    return None if properties is None else properties.get("material_preset")
