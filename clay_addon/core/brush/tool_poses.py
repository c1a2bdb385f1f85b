# SPDX-License-Identifier: GPL-3.0-or-later
"""A pose for each mesh and mirrored copy of a tool, from the place of its tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....solver.geometry.rotations import frame_of, matrices_from_rotation_vectors
from ..tools.meshes import WIRE_LENGTH
from ..tools.settings import BrushSettings
from .mirror import mirror_matrices, snap_to_planes, used_copies
from .stroke import PINCH_LEAN, PINCH_OPEN

_TOUCHING = 0.5
_OFF = 2.0
"""Distance of the plate from the centers of the farthest particles [spacings]: holding, and not."""

_LEAN = np.eye(4)
_LEAN[:3, :3] = matrices_from_rotation_vectors((0.0, PINCH_LEAN, 0.0))


def part_poses(
    settings: BrushSettings,
    parts: int,
    made_radius: float,
    gap: float | None,
    rolled: float,
    extent: float,
) -> list[NDArray[np.float64]]:
    """Poses of a tool's parts in its own frame, whose origin is the tip; shape [4, 4] each.

    Args:
        settings: Of the brush.
        parts: Number of meshes, without the plate.
        made_radius: The radius that the meshes were made for [m].
        gap: Half the distance between the axes of two fingers [m]; wide open if not given.
        rolled: Angle by which a rolling tool has turned about X [rad].
        extent: Of the clay [m]; a wire reaches through all of it.
    """
    radius = settings.radius
    sized = np.diag([radius / made_radius] * 3 + [1.0])
    if settings.tool.path == "view":
        # From any place of the clay to well out of it on either side.
        return [np.diag([1.0, 1.0, 2.2 * max(extent, radius) / WIRE_LENGTH, 1.0])]
    if settings.tool.path == "pinch":
        away = PINCH_OPEN * radius if gap is None else gap
        return [
            np.diag([sign, sign, 1.0, 1.0]) @ _shift((away, 0.0, 0.0)) @ _LEAN @ sized
            for sign in (1.0, -1.0)
        ]
    if settings.tool.rolls and rolled:
        cosine, sine = np.cos(rolled), np.sin(rolled)
        turn = np.eye(4)
        turn[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
        return [_shift((0.0, 0.0, radius)) @ turn @ _shift((0.0, 0.0, -radius)) @ sized] * parts
    return [sized] * parts


def copy_poses(
    settings: BrushSettings,
    tip: NDArray[np.float64],
    rotation: NDArray[np.float64],
    enabled: bool,
    parts: list[NDArray[np.float64]],
) -> list[tuple[NDArray[np.float64], bool]]:
    """Poses of all parts of all copies, and whether the clay feels each.

    Args:
        settings: Of the brush.
        tip: Where the tool's tip is [m], shape [3].
        rotation: World from the tool's axes, shape [3, 3].
        enabled: Whether the clay feels the tool.
        parts: The result of `part_poses`; empty for a brush that touches nothing.
    """
    if not parts:
        return []
    axes, frame = settings.mirror, settings.mirror_frame
    coinciding = (False, False, False)
    if any(axes) and settings.tool.path != "view":
        tip, normal, coinciding = snap_to_planes(tip, rotation[:, 2], settings.radius, axes, frame)
        rotation = frame_of(normal, rotation[:, 1])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, tip
    copies = zip(mirror_matrices(axes, frame), used_copies(axes, coinciding), strict=True)
    return [(matrix @ pose @ part, enabled and used) for matrix, used in copies for part in parts]


def fence_pose(
    settings: BrushSettings,
    positions: NDArray[np.floating],
    direction: NDArray[np.float64],
    felt: bool,
) -> NDArray[np.float64]:
    """Pose of the plate that holds the clay while it is cut, shape [4, 4].

    A blade pushes harder than light clay sticks to its table. Tools do not collide with each other,
    so the blade passes through the plate.

    Args:
        settings: Of the brush.
        positions: The clay when the stroke began [m], shape [N, 3].
        direction: Unit vector of the stroke, shape [3].
        felt: Whether it touches the clay or stands off.
    """
    middle = positions.mean(0, dtype=np.float64)
    far = float((positions @ direction.astype(np.float32)).max()) - float(middle @ direction)
    far += (_TOUCHING if felt else _OFF) * settings.spacing
    extent = float(np.ptp(positions, axis=0).max())
    pose = np.eye(4)
    sizes = np.array([4.0 * extent, 4.0 * extent, 4.0 * settings.spacing])
    pose[:3, :3] = frame_of(-direction, np.eye(3)[np.argmin(np.abs(direction))]) * sizes
    pose[:3, 3] = middle + far * direction
    return pose


def _shift(offset: tuple[float, float, float]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix
