# SPDX-License-Identifier: GPL-3.0-or-later
"""The initial pieces of clay of the character scene: a bust, pellets and a beret."""

from __future__ import annotations

from math import radians

import bpy
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

from ..base.mesh_geometry import evaluated_mesh, transform
from .parts import Vec3, plain_material

HEAD = 0.095
"""Height of the head [m], the unit of all other lengths of the bust."""
_TILT = Matrix.Rotation(radians(-22.0), 4, "X")
"""Makes her look up a little."""
_BODY = (
    ("neck", (0.0, 0.00, -0.46), (0.30, 0.36, 0.36)),
    ("body", (0.0, 0.04, -0.84), (0.46, 0.35, 0.38)),
)
"""Center and radii of the ellipsoids below the head [heads]."""
_BASE = -0.98
"""Height at which the bust is cut flat, so that it stands [heads]."""


def add_bust(color: Vec3) -> bpy.types.Object:
    """Add Suzanne's head on a neck and shoulders, roughly blocked out, standing at height 0.

    Args:
        color: Linear RGB.
    """
    items = []
    bpy.ops.mesh.primitive_monkey_add(size=1.0)
    head = bpy.context.object
    head.data.transform(_TILT)
    smooth = head.modifiers.new("Smooth", "SUBSURF")
    smooth.levels = 2
    # Make her chubby, as the ears must be several particles thick.
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
    """Add a sphere or an ellipsoid.

    Args:
        name: Name of the piece.
        place: Center [m].
        radii: Radius, or radii along x, y and z [m].
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
    """The surface of a piece, for placing other pieces and tools on it."""

    def __init__(self, item: bpy.types.Object) -> None:
        depsgraph = bpy.context.evaluated_depsgraph_get()
        vertices, triangles = evaluated_mesh(item, depsgraph)
        places = transform(item.matrix_world, vertices)
        self.low, self.high = places.min(axis=0), places.max(axis=0)
        self._tree = BVHTree.FromPolygons(places.tolist(), triangles.tolist())

    def hit(self, origin: Vec3, way: Vec3) -> tuple[Vector, Vector]:
        """First intersection of a ray with the surface, and the outward normal there.

        Args:
            origin: Start of the ray, outside the piece [m].
            way: Direction of the ray.

        Raises:
            ValueError: The ray misses the surface.
        """
        place, normal, _, _ = self._tree.ray_cast(Vector(origin), Vector(way).normalized())
        if place is None:
            raise ValueError(f"The ray from {origin} along {way} hits nothing.")
        return place, normal

    def front(self, x: float, z: float) -> tuple[Vector, Vector]:
        """Position and normal of the front surface at x and z of the front view [m]."""
        return self.hit((x, -1.0, z), (0.0, 1.0, 0.0))
