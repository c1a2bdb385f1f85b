# SPDX-License-Identifier: GPL-3.0-or-later
"""Material values as properties of a clay object, generated from the solver's `MATERIAL_FIELDS`.

An optional value has a switch property, named ``use_`` plus the value's name. While it is off, the
value follows another one, as its field describes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ...solver.scene.material import MATERIAL_FIELDS, Material, MaterialField


def switch_name(field: MaterialField) -> str:
    """Name of the property that says whether an optional value is given."""
    return f"use_{field.name}"


def property_names() -> tuple[str, ...]:
    """Names of all properties that a material has on a clay object."""
    names = []
    for field in MATERIAL_FIELDS:
        if field.is_optional:
            names.append(switch_name(field))
        names.append(field.name)
    return tuple(names)


def property_declarations(update: Callable[[Any, Any], None]) -> dict[str, Any]:
    """A material's properties, as annotations for a class that Blender registers.

    Args:
        update: Called by Blender when a value has changed.
    """
    declared: dict[str, Any] = {}
    for field in MATERIAL_FIELDS:
        description = f"{field.description} [{field.unit}]" if field.unit else field.description
        if field.is_optional:
            declared[switch_name(field)] = bpy.props.BoolProperty(
                name=field.label, description=field.description, default=False, update=update
            )
        declared[field.name] = bpy.props.FloatProperty(
            name=field.label_with_unit,
            description=description,
            default=0.0 if field.default is None else field.default,
            min=field.minimum,
            soft_max=field.soft_maximum,
            update=update,
        )
    return declared


def read_material(properties: Any) -> Material:
    """The material described by a clay object's properties.

    Raises:
        ValueError: A value is out of range.
    """
    return Material(
        **{
            field.name: getattr(properties, field.name)
            for field in MATERIAL_FIELDS
            if not field.is_optional or getattr(properties, switch_name(field))
        }
    )


def write_material(properties: Any, material: Material) -> None:
    """Set a clay object's properties to a material."""
    for field in MATERIAL_FIELDS:
        value = getattr(material, field.name)
        if field.is_optional:
            setattr(properties, switch_name(field), value is not None)
        if value is not None:
            setattr(properties, field.name, value)


def copy_material(source: Any, target: Any) -> None:
    """Copy the material properties of one clay object to another, where they differ."""
    for name in property_names():
        if getattr(target, name) != getattr(source, name):
            setattr(target, name, getattr(source, name))


def draw_material(layout: bpy.types.UILayout, properties: Any) -> None:
    """Draw a row for each value."""
    column = layout.column(align=True)
    # Without a split, the sliders have room for labels with units.
    column.use_property_split = False
    for field in MATERIAL_FIELDS:
        if field.is_optional:
            row = column.row(align=True)
            switch = switch_name(field)
            row.prop(properties, switch, text="")
            value = row.row(align=True)
            value.active = getattr(properties, switch)
            value.prop(properties, field.name)
        else:
            column.prop(properties, field.name)
