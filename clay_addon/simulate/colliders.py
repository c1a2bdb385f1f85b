# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders of a simulated scene, at the first frame and later ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.geometry.rotations import rotation_and_stretch
from ..base.mesh_geometry import evaluated_mesh, transform
from ..base.units import to_meters
from ..model.clay_scene import SimulationError, is_enabled

if TYPE_CHECKING:
    from ...solver import MeshCollider


@dataclass
class MovingCollider:
    """A mesh collider, which may move and deform."""

    item: bpy.types.Object
    """The object."""
    vertices: NDArray[np.float64]
    """Local vertices at the first frame [Blender units], shape [V, 3]."""
    triangles: NDArray[np.int32]
    """Triangles, wound outward, shape [F, 3]."""
    stretch: NDArray[np.float64]
    """Stretch of the object's matrix at the first frame, without its rotation, shape [3, 3]."""
    handle: MeshCollider | None = None
    """The collider in the solver's scene."""

    def state(
        self, depsgraph: bpy.types.Depsgraph
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vertices with the object's scale applied [m], and the object's pose without scale [m].

        Raises:
            SimulationError: The collider has changed in a way that the solver does not support.
        """
        scene = depsgraph.scene
        vertices, _ = evaluated_mesh(self.item, depsgraph)
        if vertices.shape != self.vertices.shape:
            raise SimulationError(
                f"{self.item.name!r} has {len(vertices)} vertices at frame "
                f"{scene.frame_current} and {len(self.vertices)} at the first frame. A "
                "collider may deform, but its number of vertices must stay the same."
            )
        matrix = np.array(self.item.evaluated_get(depsgraph).matrix_world, np.float64)
        if not (np.isfinite(vertices).all() and np.isfinite(matrix).all()):
            raise SimulationError(
                f"{self.item.name!r} is not finite (NaN or infinite) at frame "
                f"{scene.frame_current}."
            )
        rotation, stretch = rotation_and_stretch(matrix[:3, :3])
        # Blender's matrices are single precision: without this, a collider that only rotates would
        # seem to deform in every frame.
        if np.allclose(stretch, self.stretch, rtol=0.0, atol=2e-6 * np.abs(stretch).max()):
            stretch = self.stretch
        elif np.linalg.det(stretch) * np.linalg.det(self.stretch) <= 0.0:
            raise SimulationError(
                f"{self.item.name!r} is scaled flat or turned inside out at frame "
                f"{scene.frame_current}. Keep its scale away from zero."
            )
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = to_meters(scene, matrix[:3, 3])
        return to_meters(scene, vertices @ stretch.T), pose


@dataclass
class FlatCollider:
    """An infinite plane, which cannot move."""

    item: bpy.types.Object
    """The object."""
    point: NDArray[np.float64]
    """A point on the plane in world space [Blender units], shape [3]."""
    normal: NDArray[np.float64]
    """Unit normal toward the clay, shape [3]."""

    def check(self, depsgraph: bpy.types.Depsgraph, spacing: float) -> None:
        """Refuse a plane that was disabled or moves.

        Args:
            depsgraph: The evaluated scene.
            spacing: Particle spacing [Blender units].

        Raises:
            SimulationError: The plane is disabled or moves; the message names it.
        """
        frame = depsgraph.scene.frame_current
        if not is_enabled(self.item, depsgraph):
            raise SimulationError(
                f"{self.item.name!r} does not touch the clay at frame "
                f"{frame}, but an infinite plane always does. Switch on "
                "Touches Clay, or give it thickness (Solidify modifier), so that it is a "
                "closed mesh."
            )
        vertices, _ = evaluated_mesh(self.item, depsgraph)
        matrix = self.item.evaluated_get(depsgraph).matrix_world
        away = (transform(matrix, vertices) - self.point) @ self.normal
        # The negation also catches NaN.
        if not float(np.abs(away).max()) <= 1e-3 * spacing:
            raise SimulationError(
                f"{self.item.name!r} moves at frame {frame}, but an "
                "infinite plane cannot move. Give it thickness (Solidify modifier), so that "
                "it is a closed mesh."
            )
