# SPDX-License-Identifier: GPL-3.0-or-later
"""Test of whether points lie inside a closed mesh."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.recording_lock import recording_lock
from .closed_mesh import ClosedMesh


@wp.kernel(enable_backward=False)
def measure_sign(
    mesh: wp.uint64, point: wp.array[wp.vec3], max_distance: float, inside: wp.array[int]
) -> None:
    """Mark points inside the mesh, by its winding number."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, point[i], max_distance)
    if query.result and query.sign < 0.0:
        inside[i] = 1


def is_inside(points: NDArray[np.floating], mesh: ClosedMesh) -> NDArray[np.bool_]:
    """Whether each point lies inside a closed mesh, shape [N].

    Args:
        points: Points [m], shape [N, 3].
        mesh: The mesh; its bodies may overlap and have cavities.
    """
    if not len(points):
        return np.zeros(0, bool)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    center, size = 0.5 * (low + high), float((high - low).max())
    local = ((mesh.vertices - center) / size).astype(np.float32)
    with recording_lock:
        surface = wp.Mesh(
            points=wp.array(local, dtype=wp.vec3, device="cpu"),
            indices=wp.array(mesh.faces.ravel(), dtype=int, device="cpu"),
            support_winding_number=True,
        )
        place = ((np.asarray(points, np.float64) - center) / size).astype(np.float32)
        inside = wp.zeros(len(points), dtype=int, device="cpu")
        wp.launch(
            measure_sign,
            dim=len(points),
            inputs=[surface.id, wp.array(place, dtype=wp.vec3, device="cpu"), 10.0, inside],
            device="cpu",
        )
    return np.asarray(inside.numpy() == 1)
