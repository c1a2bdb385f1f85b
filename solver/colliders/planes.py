# SPDX-License-Identifier: GPL-3.0-or-later
"""The planes of a scene on the device."""

import numpy as np
import warp as wp

from ..scene.scene import Plane


class PlaneColliders:
    """All planes of a scene.

    Args:
        planes: The planes.
        device: Warp device.
    """

    def __init__(self, planes: list[Plane], device: wp.Device) -> None:
        points = np.array([plane.point for plane in planes], np.float32)
        normals = np.array([plane.normal for plane in planes], np.float32)
        self.point = wp.array(points, dtype=wp.vec3, device=device)
        self.normal = wp.array(normals, dtype=wp.vec3, device=device)
