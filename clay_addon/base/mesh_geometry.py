# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated Blender meshes as numpy arrays, and their transforms."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

SWITCHED_OFF = (
    "is switched off in the viewport, or its collection is excluded from the view layer, so "
    "Blender does not evaluate it. Switch it on (hiding it with H is fine)."
)


def is_switched_off(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether Blender does not evaluate an object, that is, its animation and modifiers."""
    return not item.evaluated_get(depsgraph).is_evaluated


def is_absent(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether an object is off in the viewport, and so has no part in a simulation.

    It is off by its own switch (the monitor), which may be keyed, or by a collection that is off or
    excluded. Hiding it with H, local view and the switch for rendering (the camera) change only
    what one sees. Blender neither moves nor deforms an object while it is off.
    """
    evaluated = item.evaluated_get(depsgraph)
    return not evaluated.is_evaluated or bool(evaluated.hide_viewport)


def evaluated_mesh(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and triangles of a mesh object with its modifiers applied.

    Includes instances made by its geometry nodes, as they are visible too.

    Args:
        item: A mesh object.
        depsgraph: The evaluated dependency graph.

    Returns:
        Vertices in the object's coordinates [Blender units], shape [V, 3], and triangles, shape
        [F, 3], counter-clockwise seen from outside.
    """
    evaluated = item.evaluated_get(depsgraph)
    parts = [_mesh_arrays(evaluated)]
    if any(modifier.type == "NODES" for modifier in item.modifiers):
        parts += _instances(item, evaluated, depsgraph)
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate(
            [triangles + start for (_, triangles), start in zip(parts, starts, strict=False)]
        ).astype(np.int32),
    )


def _mesh_arrays(
    evaluated: bpy.types.Object,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    mesh = evaluated.to_mesh()
    try:
        vertices = np.empty((len(mesh.vertices), 3), np.float32)
        if len(vertices):
            mesh.attributes["position"].data.foreach_get("vector", vertices.ravel())
        mesh.calc_loop_triangles()
        triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    finally:
        evaluated.to_mesh_clear()
    return vertices.astype(np.float64), triangles


def _instances(
    item: bpy.types.Object, evaluated: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> list[tuple[NDArray[np.float64], NDArray[np.int32]]]:
    """The meshes that an object instances, in the object's coordinates."""
    meshes: dict[int, tuple[NDArray[np.float64], NDArray[np.int32]]] = {}
    parts = []
    from_world = evaluated.matrix_world.inverted_safe()
    for instance in depsgraph.object_instances:
        if not instance.is_instance or instance.parent is None:
            continue
        if instance.parent.original != item or instance.object.type != "MESH":
            continue
        key = instance.object.data.session_uid
        if key not in meshes:
            meshes[key] = _mesh_arrays(instance.object)
        vertices, triangles = meshes[key]
        matrix = from_world @ instance.matrix_world
        parts.append((transform(matrix, vertices), oriented_triangles(matrix, triangles)))
    return parts


def transform(matrix: object, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Points transformed by a 4×4 matrix, shape [N, 3]."""
    # By columns: numpy's product of a long array with a 3×3 matrix takes twenty times as long.
    x, y, z = np.ascontiguousarray(np.asarray(points).T, np.float64)
    moved = np.empty((len(x), 3))
    for axis, (along_x, along_y, along_z, offset) in enumerate(np.asarray(matrix, np.float64)[:3]):
        moved[:, axis] = x * along_x + y * along_y + z * along_z + offset
    return moved


def world_matrix(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None
) -> NDArray[np.float64]:
    """Where an object is, shape [4, 4].

    The matrix of the object itself is the one of the viewport: a render evaluates parents,
    constraints and drivers in a dependency graph of its own, which leaves it as it was.

    Args:
        item: The object.
        depsgraph: The evaluated state to take it from; the viewport's where not given.
    """
    source = item
    if depsgraph is not None:
        evaluated = item.evaluated_get(depsgraph)
        source = evaluated if evaluated.is_evaluated else item
    return np.array(source.matrix_world, np.float64)


def local_from_world(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None
) -> NDArray[np.float64]:
    """The 4×4 matrix that brings world positions into an object's coordinates.

    Args:
        item: The object.
        depsgraph: See `world_matrix`.

    Raises:
        ValueError: The object's transform is not invertible.
    """
    matrix = world_matrix(item, depsgraph)
    if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise ValueError(
            f"{item.name!r} is scaled to zero or its transform is not finite. Clear its transform"
        )
    return np.linalg.inv(matrix)


def oriented_triangles(matrix: object, triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """The triangles, with reversed winding if the matrix mirrors."""
    if np.linalg.det(np.asarray(matrix, np.float64)[:3, :3]) < 0:
        return np.ascontiguousarray(triangles[:, ::-1])
    return triangles


def flat_plane(
    vertices: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Point and unit normal of the plane through all vertices; None if they are not coplanar.

    Also None if all vertices lie on a line or in a point, where the plane is not unique.
    """
    if len(vertices) < 3 or not np.isfinite(vertices).all():
        return None
    center = vertices.mean(0)
    _, extents, axes = np.linalg.svd(vertices - center, full_matrices=False)
    if extents[2] > 1e-5 * extents[0] or extents[1] <= 1e-5 * extents[0]:
        return None
    return center, axes[2]
