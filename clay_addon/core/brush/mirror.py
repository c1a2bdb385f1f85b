# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirrored copies of a tool, about the local planes of the clay object.

Blender's Sculpt Mode mirrors about these planes too. Make Clay puts the origin at the center of the
clay, so a symmetric object stays symmetric wherever it is.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

SNAP = 0.3
"""A tool closer to a mirror plane than this snaps to it, without a mirrored copy [brush radii].

Two tools in nearly the same place would violently squeeze out the clay between them.
"""


def mirror_matrices(
    axes: tuple[bool, bool, bool], frame: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """The mirroring matrix in world space for each copy, the identity first; shape [4, 4] each.

    Args:
        axes: Whether to mirror X, Y and Z.
        frame: Matrix from the mirror frame to the world [m], shape [4, 4].
    """
    back = np.linalg.inv(frame)
    signs = product(*((1.0, -1.0) if used else (1.0,) for used in axes))
    return [frame @ np.diag([*sign, 1.0]) @ back for sign in signs]


def snap_to_planes(
    point: NDArray[np.float64],
    normal: NDArray[np.float64],
    radius: float,
    axes: tuple[bool, bool, bool],
    frame: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[bool, bool, bool]]:
    """Move a tool that is near a mirror plane onto the plane.

    Args:
        point: Location of the tool [m], shape [3].
        normal: Direction of its handle, a unit vector, shape [3].
        radius: Radius of the brush [m].
        axes: Whether to mirror X, Y and Z.
        frame: Matrix from the mirror frame to the world [m], shape [4, 4].

    Returns:
        The point, the normal, and for each axis whether its copy coincides with the original.
    """
    local = frame[:3, :3].T @ (point - frame[:3, 3])
    local_normal = frame[:3, :3].T @ normal
    on = tuple(used and abs(local[k]) < SNAP * radius for k, used in enumerate(axes))
    local = np.where(on, 0.0, local)
    flat = np.where(on, 0.0, local_normal)
    size = float(np.linalg.norm(flat))
    # If the surface is parallel to the mirror plane, the projection vanishes: keep the normal.
    local_normal = flat / size if size > 0.1 else local_normal
    return (
        frame[:3, :3] @ local + frame[:3, 3],
        frame[:3, :3] @ local_normal,
        (on[0], on[1], on[2]),
    )


def used_copies(axes: tuple[bool, bool, bool], coinciding: tuple[bool, bool, bool]) -> list[bool]:
    """Whether each copy of `mirror_matrices` differs from those before it."""
    flips = product(*((False, True) if used else (False,) for used in axes))
    return [not any(f and c for f, c in zip(flip, coinciding, strict=True)) for flip in flips]
