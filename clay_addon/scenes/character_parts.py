# SPDX-License-Identifier: GPL-3.0-or-later
"""The pieces of clay of the character scene before they are worked: a bust, pellets and a beret."""

from __future__ import annotations

from math import radians

import bpy
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

from ..base.mesh_geometry import evaluated_mesh, transform
from .parts import Vec3, plain_material

HEAD = 0.095
"""Height of the head, to which all lengths of the bust are drawn [m]."""
_TILT = Matrix.Rotation(radians(-22.0), 4, "X")
"""Makes her look up a little."""
_BODY = (
    ("neck", (0.0, 0.00, -0.46), (0.30, 0.36, 0.36)),
    ("body", (0.0, 0.04, -0.84), (0.46, 0.35, 0.38)),
)
"""Middle and radii of the ellipsoids under the head [heads]."""
_BASE = -0.98
"""Below this she is cut flat, to stand [heads]."""


def add_bust(color: Vec3) -> bpy.types.Object:
    """Suzanne's head on a neck and shoulders, as roughly blocked out, standing on height 0.

    Args:
        color: Linear RGB.
    """
    items = []
    bpy.ops.mesh.primitive_monkey_add(size=1.0)
    head = bpy.context.object
    head.data.transform(_TILT)
    smooth = head.modifiers.new("Smooth", "SUBSURF")
    smooth.levels = 2
    # Ears must be several particles thick: make her chubby.
    plump = head.modifiers.new("Chubby", "DISPLACE")
    plump.strength, plump.mid_level = 0.045, 0.0
    for modifier in (smooth, plump):
        bpy.ops.object.modifier_apply(modifier=modifier.name)
    items.append(head)
    for _, center, radii in _BODY:
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=1.0)
        part = bpy.context.object
        part.data.transform(Matrix.LocRotScale(center, None, radii))
        items.append(part)
    with bpy.context.temp_override(
        active_object=head, object=head, selected_editable_objects=items
    ):
        bpy.ops.object.join()
    for vertex in head.data.vertices:
        vertex.co.z = max(vertex.co.z, _BASE) - _BASE
    head.data.transform(Matrix.Scale(HEAD, 4))
    remesh = head.modifiers.new("Close", "REMESH")
    remesh.mode, remesh.voxel_size = "VOXEL", 0.018 * HEAD
    soften = head.modifiers.new("Soften", "SMOOTH")
    soften.factor, soften.iterations = 0.5, 8
    return _finish(head, "Bust", color)


def add_ball(name: str, place: Vector, radii: float | Vec3, color: Vec3) -> bpy.types.Object:
    """A ball of clay, or an ellipsoid.

    Args:
        name: Of the piece.
        place: Its middle [m].
        radii: Radius, or those along x, y and z [m].
        color: Linear RGB.
    """
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=1.0)
    item = bpy.context.object
    item.scale = (radii,) * 3 if isinstance(radii, float) else radii
    item.location = place
    return _finish(item, name, color)


def _finish(item: bpy.types.Object, name: str, color: Vec3) -> bpy.types.Object:
    item.name = item.data.name = name
    item.data.materials.append(plain_material(name, color, 0.6))
    bpy.context.view_layer.update()
    return item


class Skin:
    """Where the surface of a piece is, for what is set on it and what presses on it."""

    def __init__(self, item: bpy.types.Object) -> None:
        depsgraph = bpy.context.evaluated_depsgraph_get()
        vertices, triangles = evaluated_mesh(item, depsgraph)
        places = transform(item.matrix_world, vertices)
        self.low, self.high = places.min(axis=0), places.max(axis=0)
        self._tree = BVHTree.FromPolygons(places.tolist(), triangles.tolist())

    def met(self, origin: Vec3, way: Vec3) -> tuple[Vector, Vector]:
        """Where a ray meets the surface first, and the outward normal there.

        Args:
            origin: Where it starts, outside [m].
            way: Where it goes.

        Raises:
            ValueError: It misses.
        """
        place, normal, _, _ = self._tree.ray_cast(Vector(origin), Vector(way).normalized())
        if place is None:
            raise ValueError(f"Nothing is met from {origin} along {way}.")
        return place, normal

    def front(self, x: float, z: float) -> tuple[Vector, Vector]:
        """Place and normal of the front at a point of the front view [m]."""
        return self.met((x, -1.0, z), (0.0, 1.0, 0.0))
