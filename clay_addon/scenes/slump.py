# SPDX-License-Identifier: GPL-3.0-or-later
"""The slump test: a cylinder of soft clay that sinks under its own weight, compared with theory.

Pashias, Boger, Summers and Glenister 1996, *A fifty cent rheometer for yield stress measurement*,
doi 10.1122/1.550780.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import bpy
import numpy as np
from mathutils import Matrix

from ...solver.scene.material import Material
from ..base.units import meters_per_unit
from ..model.clay_scene import collider_objects
from .block import clay_from, new_spacing
from .parts import mesh_object, plain_material
from .stage import add_table, scene_preset

_SIDES = 48
"""Number of sides of the cylinder."""


@dataclass(frozen=True)
class SlumpTest:
    """The objects of a slump test, and the expected result."""

    clay: bpy.types.Object
    """The clay, a point cloud."""
    expected: float
    """Expected slump of its top, as a fraction of its height."""
    ring: bpy.types.Object
    """A ring at the height where the top should come to rest."""


def expected_slump(yield_stress: float, density: float, gravity: float, height: float) -> float:
    """Slump of a cylinder as a fraction of its height: s′ = 1 − 2τ′(1 − ln 2τ′).

    Args:
        yield_stress: Yield stress in shear [Pa].
        density: Density [kg/m³].
        gravity: Gravitational acceleration [m/s²].
        height: Height of the cylinder [m].

    Returns:
        From 0 for clay that does not sink, as without gravity, to 1 for a liquid.
    """
    weight = density * gravity * height
    if weight <= 0.0:
        return 0.0
    ratio = 2.0 * yield_stress / weight
    if ratio <= 0.0:
        return 1.0
    return 1.0 - ratio * (1.0 - math.log(ratio)) if ratio < 1.0 else 0.0


def add_slump_test(
    context: bpy.types.Context,
    *,
    height: float = 0.0,
    yield_stress: float = 0.0,
    spacing: float = 0.0,
    table: bool = True,
) -> SlumpTest:
    """Add a cylinder of soft clay, as wide as high, on the 3D cursor, and mark the expected slump.

    Args:
        context: Its collection gets the objects.
        height: Height [Blender units]; 0 for about 3,000 particles.
        yield_stress: Yield stress in shear [Pa]; 0 for a tenth of density times gravity times
            height.
        spacing: Distance between particles [Blender units]; 0 for that of the scene's clay.
        table: Whether to add a table if the scene has no collider.

    Raises:
        ClayError: It cannot be made; the message says why, and nothing has changed.
    """
    scene = context.scene
    data = scene_preset("slump")
    scale = meters_per_unit(scene)
    spacing = new_spacing(scene, spacing, data["spacing"])
    height = height or spacing * data["height"] / data["spacing"]
    material = Material(**data["material"])
    gravity = -scene.gravity[2] * scale if scene.use_gravity else 0.0
    if not yield_stress:
        # Scaled so that the slump is the same at every height.
        yield_stress = material.yield_stress * height * scale / data["height"]
    material = replace(material, yield_stress=yield_stress)
    clay = clay_from(
        context,
        _cylinder(scene.cursor.location, height),
        spacing,
        material=material,
        color=data["color"],
    )
    if table and not collider_objects(scene):
        add_table(context, scene.cursor.location)
    expected = expected_slump(yield_stress, material.density, gravity, height * scale)
    ring = _mark(context, height, expected, scale)
    for other in context.selected_objects:
        other.select_set(False)
    clay.select_set(True)
    context.view_layer.objects.active = clay
    return SlumpTest(clay, expected, ring)


def _cylinder(place: tuple[float, float, float], height: float) -> bpy.types.Object:
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    # Same cross-sectional area as a round cylinder.
    radius = 0.5 * height / math.sqrt(math.sin(2 * math.pi / _SIDES) * _SIDES / (2 * math.pi))
    rim = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [np.column_stack([rim, np.full(_SIDES, level)]) for level in (0.0, height)]
    sides = [(k, (k + 1) % _SIDES, (k + 1) % _SIDES + _SIDES, k + _SIDES) for k in range(_SIDES)]
    ends = [tuple(reversed(range(_SIDES))), tuple(range(_SIDES, 2 * _SIDES))]
    body = mesh_object("Slump test", np.concatenate(rings), [*sides, *ends])
    body.location = place
    return body


def _mark(
    context: bpy.types.Context, height: float, expected: float, scale: float
) -> bpy.types.Object:
    """Add a ring around the cylinder where its top should come to rest, and a text about it."""
    paint = plain_material("Expected", (0.75, 0.05, 0.03), 0.5)
    place = context.scene.cursor.location
    left = (1.0 - expected) * height
    line = bpy.data.curves.new("Expected slump", "CURVE")
    line.dimensions, line.bevel_depth = "3D", 0.006 * height
    spline = line.splines.new("POLY")
    spline.points.add(_SIDES - 1)
    spline.use_cyclic_u = True
    for k, point in enumerate(spline.points):
        angle = 2 * math.pi * k / _SIDES
        point.co = (1.1 * height * math.cos(angle), 1.1 * height * math.sin(angle), 0.0, 1.0)
    text = bpy.data.curves.new("Expected slump text", "FONT")
    text.body = (
        f"expected slump {expected:.2f} of the height:\n"
        f"the top comes to rest at {left * scale * 1e3:.0f} mm\n(Pashias et al. 1996)"
    )
    text.size = 0.12 * height
    items = []
    for name, data in (("Expected slump", line), ("Expected slump text", text)):
        data.materials.append(paint)
        item = bpy.data.objects.new(name, data)
        context.collection.objects.link(item)
        items.append(item)
    ring, words = items
    ring.location = (place[0], place[1], place[2] + left)
    words.matrix_world = Matrix.Translation(
        (place[0] + 1.2 * height, place[1], place[2] + left)
    ) @ Matrix.Rotation(math.radians(90.0), 4, "X")
    return ring
