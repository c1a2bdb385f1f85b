# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses of each mesh and mirrored copy of a tool, from the pose of its tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....solver.geometry.rotations import frame_of, matrices_from_rotation_vectors
from ..tools.meshes import WIRE_LENGTH
from ..tools.settings import BrushSettings
from .mirror import mirror_matrices, snap_to_planes, used_copies
from .stroke import PINCH_LEAN, PINCH_OPEN

_HOLDING = 0.5
_CLEAR = 2.0
"""Distance of the plate from the centers of the farthest particles, holding and not [spacings]."""

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
    """Poses of a tool's parts in the tool's frame, whose origin is the tip; shape [4, 4] each.

    Args:
        settings: Settings of the brush.
        parts: Number of meshes, without the plate.
        made_radius: Radius that the meshes were made for [m].
        gap: Half the distance between the axes of two fingers [m]; wide open by default.
        rolled: Angle by which a rolling tool has turned about X [rad].
        extent: Extent of the clay [m]; a wire reaches through all of it.
    """
    radius = settings.radius
    sized = np.diag([radius / made_radius] * 3 + [1.0])
    if settings.tool.path == "view":
        # Long enough to stick out of the clay at both ends, wherever it cuts.
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
    """Poses of all parts of all mirrored copies, and whether each acts on the clay.

    Args:
        settings: Settings of the brush.
        tip: Location of the tool's tip [m], shape [3].
        rotation: Rotation matrix from the tool's axes to the world, shape [3, 3].
        enabled: Whether the tool acts on the clay.
        parts: The result of `part_poses`; empty for a brush without meshes.
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
    enabled: bool,
) -> NDArray[np.float64]:
    """Pose of the plate that holds the clay while it is cut, shape [4, 4].

    Without it, a blade would push light clay along the table. Tools do not collide with each other,
    so the blade passes through the plate.

    Args:
        settings: Settings of the brush.
        positions: The clay's particles at the start of the stroke [m], shape [N, 3].
        direction: Unit vector of the stroke, shape [3].
        enabled: Whether it touches the clay or stays clear of it.
    """
    middle = positions.mean(0, dtype=np.float64)
    far = float((positions @ direction.astype(np.float32)).max()) - float(middle @ direction)
    far += (_HOLDING if enabled else _CLEAR) * settings.spacing
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
