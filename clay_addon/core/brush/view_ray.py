# SPDX-License-Identifier: GPL-3.0-or-later
"""Projection between a 3D view and the scene, without Blender."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Ray:
    """A ray."""

    origin: NDArray[np.float64]
    """Start point [m], shape [3]."""
    direction: NDArray[np.float64]
    """Unit vector, shape [3]."""

    def at(self, distance: float) -> NDArray[np.float64]:
        """The point at a distance [m] from the origin, shape [3]."""
        return self.origin + distance * self.direction

    def intersect_plane(
        self, point: NDArray[np.float64], normal: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Intersection with a plane [m], shape [3]; None if the ray is parallel or points away."""
        slope = float(self.direction @ normal)
        if abs(slope) < 1e-6:
            return None
        distance = float((point - self.origin) @ normal) / slope
        return self.at(distance) if distance > 0.0 else None


@dataclass(frozen=True)
class View:
    """How a region shows the scene at one moment.

    Example::

        view = View(perspective, view_matrix, True, width=800, height=600, scale=1.0)
        ray = view.ray(400, 300)
    """

    perspective: NDArray[np.float64]
    """World coordinates [Blender units] to clip space, shape [4, 4]."""
    view_matrix: NDArray[np.float64]
    """World coordinates [Blender units] to camera space, shape [4, 4]."""
    is_perspective: bool
    """False for an orthographic view."""
    width: int
    """Width of the region [pixels]."""
    height: int
    """Height of the region [pixels]."""
    scale: float
    """Length of a Blender unit [m]."""

    @cached_property
    def _camera(self) -> NDArray[np.float64]:
        return np.linalg.inv(np.asarray(self.view_matrix, np.float64))

    @cached_property
    def _unproject(self) -> NDArray[np.float64]:
        return np.linalg.inv(np.asarray(self.perspective, np.float64))

    @property
    def right(self) -> NDArray[np.float64]:
        """Unit vector to the right on the screen, shape [3]."""
        return _unit(self._camera[:3, 0])

    @property
    def up(self) -> NDArray[np.float64]:
        """Unit vector upward on the screen, shape [3]."""
        return _unit(self._camera[:3, 1])

    @property
    def forward(self) -> NDArray[np.float64]:
        """Unit vector into the screen, shape [3]."""
        return -_unit(self._camera[:3, 2])

    def ray(self, x: float, y: float) -> Ray:
        """The ray through a pixel.

        Args:
            x: Distance from the region's left edge [pixels].
            y: Distance from the region's lower edge [pixels].
        """
        clip = np.array([2.0 * x / self.width - 1.0, 2.0 * y / self.height - 1.0, 0.0, 1.0])
        seen = self._unproject @ clip
        point = seen[:3] / seen[3]
        if self.is_perspective:
            eye = self._camera[:3, 3]
            direction = _unit(point - eye)
            # Whatever the far plane is, depth 0 is in front of the eye: the ray points forward.
            if direction @ self.forward < 0.0:
                direction = -direction
            return Ray(eye * self.scale, direction)
        # An orthographic view also shows what is behind its camera.
        back = float(np.linalg.norm(self._camera[:3, 3])) + 1.0 / self._clip_depth
        return Ray((point - back * self.forward) * self.scale, self.forward)

    @property
    def _clip_depth(self) -> float:
        """Clip-space depth per Blender unit of an orthographic view."""
        return max(float(np.linalg.norm(self.perspective[2, :3])), 1e-9)

    def project(self, point: ArrayLike) -> tuple[float, float] | None:
        """The pixel that shows a point [m]; None if the point is behind the viewer."""
        clip = self.perspective @ np.append(np.asarray(point, np.float64) / self.scale, 1.0)
        if clip[3] <= 1e-12:
            return None
        return (
            (clip[0] / clip[3] + 1.0) * 0.5 * self.width,
            (clip[1] / clip[3] + 1.0) * 0.5 * self.height,
        )

    def pixel(self, point: ArrayLike) -> float:
        """Size of a pixel at the depth of a point [m]."""
        place = np.append(np.asarray(point, np.float64) / self.scale, 1.0)
        depth = max(float(self.perspective[3] @ place), 1e-12)
        across = abs(float(self.perspective[0, :3] @ self.right))
        return 2.0 * depth / (self.width * max(across, 1e-12)) * self.scale


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / max(float(np.linalg.norm(vector)), 1e-30)
