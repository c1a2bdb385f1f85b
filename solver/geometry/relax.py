# SPDX-License-Identifier: GPL-3.0-or-later
"""Particles that fill a mesh up to its surface, whatever angle the lattice has to it.

A lattice meets a surface that is not parallel to it in steps, and one that is parallel often in the
middle of a layer, which is then half full: in the reconstructed surface both are pits. Here the
particles near the surface repel each other and are kept half a spacing inside, until they lie
evenly (Jiang et al., "Blue noise sampling using an SPH-based method", 2015,
10.1145/2816795.2818102, with a wall in place of their boundary samples).
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.recording_lock import recording_lock
from .closed_mesh import ClosedMesh

MOVED_DEPTH = 1.6
"""Particles deeper than this stay where they are, in spacings: two layers are enough for flat faces
to come out flat, and the rest of the clay stays on its lattice."""
WALL = 0.5
"""Distance of the outermost particles from the surface, in spacings."""
REACH = 1.35
"""Particles farther apart than this do not repel each other, in spacings."""
STIFFNESS = 0.35
"""How far two particles that touch move in a round, in spacings."""
MAX_STEP = 0.12
"""Longest way of a particle in a round, in spacings."""
ROUNDS = 80


@wp.kernel(enable_backward=False)
def measure_depth(mesh: wp.uint64, point: wp.array[wp.vec3], depth: wp.array[float]) -> None:
    """Distance of each point from the surface, positive inside."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_normal(mesh, point[i], 1.0e6)
    nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    depth[i] = -query.sign * wp.length(point[i] - nearest)


@wp.kernel(enable_backward=False)
def repel(
    grid: wp.uint64,
    mesh: wp.uint64,
    moving: wp.array[int],
    step: float,
    point: wp.array[wp.vec3],
    moved: wp.array[wp.vec3],
) -> None:
    """Move particles away from each other, but not out of the mesh; lengths in spacings."""
    i = moving[wp.tid()]
    here = point[i]
    push = wp.vec3()
    for j in wp.hash_grid_query(grid, here, REACH):
        if j != i:
            away = here - point[j]
            distance = wp.length(away)
            if distance < REACH and distance > 1.0e-6:
                near = 1.0 - distance / REACH
                push += away * (near * near / distance)
    push = push * step
    length = wp.length(push)
    if length > MAX_STEP:
        push = push * (MAX_STEP / length)
    place = here + push
    query = wp.mesh_query_point_sign_normal(mesh, place, 1.0e6)
    nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    outward = (place - nearest) * query.sign
    depth = -query.sign * wp.length(place - nearest)
    if depth < WALL:
        normal = wp.mesh_eval_face_normal(mesh, query.face)
        if wp.length(outward) > 1.0e-4:
            normal = wp.normalize(outward)
        place = place - normal * (WALL - depth)
    moved[i] = place


def relax_to_surface(
    points: NDArray[np.float32], mesh: ClosedMesh, spacing: float, *, rounds: int = ROUNDS
) -> NDArray[np.float32]:
    """Let particles in a mesh lie evenly up to its surface.

    Their number stays, and so does what lies deep inside.

    Args:
        points: Particles that fill the mesh, as `fill` gives them, shape [N, 3].
        mesh: The mesh, in the same unit.
        spacing: Distance between particles, in the same unit.
        rounds: How often they are moved.

    Returns:
        Their places, shape [N, 3], in the same order.
    """
    if not len(points):
        return points
    center = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
    local = ((points - center) / spacing).astype(np.float32)
    with recording_lock:
        surface = wp.Mesh(
            points=wp.array(
                ((mesh.vertices - center) / spacing).astype(np.float32),
                dtype=wp.vec3,
                device="cpu",
            ),
            indices=wp.array(mesh.faces.ravel(), dtype=int, device="cpu"),
        )
        point = wp.array(local, dtype=wp.vec3, device="cpu")
        depth = wp.empty(len(points), dtype=float, device="cpu")
        wp.launch(measure_depth, len(points), inputs=[surface.id, point, depth], device="cpu")
        moving = np.flatnonzero(depth.numpy() < MOVED_DEPTH).astype(np.int32)
        rows = wp.array(moving, dtype=int, device="cpu")
        moved = wp.clone(point)
        grid = wp.HashGrid(64, 64, 64, device="cpu")
        for number in range(rounds if len(moving) else 0):
            grid.build(point, REACH)
            # Large steps first, so that layers that are half full dissolve.
            step = STIFFNESS * (1.0 - 0.8 * number / rounds)
            wp.launch(
                repel,
                len(moving),
                inputs=[grid.id, surface.id, rows, step, point, moved],
                device="cpu",
            )
            wp.copy(point, moved)
        return (point.numpy() * spacing + center).astype(np.float32)
