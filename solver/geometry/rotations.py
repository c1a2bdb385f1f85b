# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations as unit quaternions (x, y, z, w) and as matrices, many at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def matrices_from_quaternions(quaternions: ArrayLike) -> Array:
    """Rotation matrices of unit quaternions (x, y, z, w), shape [..., 4] to [..., 3, 3]."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternions_from_matrices(matrices: ArrayLike) -> Array:
    """Unit quaternions (x, y, z, w) with w >= 0 of rotation matrices, [..., 3, 3] to [..., 4].

    After Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", Journal of
    Guidance, Control and Dynamics 23(6), 2000 (10.2514/2.4654): the eigenvector of the largest
    eigenvalue, which is sound at every angle and forgives matrices that are not quite orthogonal.
    """
    m = np.asarray(matrices, np.float64)
    xx, xy, xz = m[..., 0, 0], m[..., 0, 1], m[..., 0, 2]
    yx, yy, yz = m[..., 1, 0], m[..., 1, 1], m[..., 1, 2]
    zx, zy, zz = m[..., 2, 0], m[..., 2, 1], m[..., 2, 2]
    rows = [
        [xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, yy - xx - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, zz - xx - yy, yx - xy],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    symmetric = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2) / 3.0
    quaternions = np.linalg.eigh(symmetric)[1][..., -1]
    return np.where(quaternions[..., 3:] < 0.0, -quaternions, quaternions)


def product(first: ArrayLike, second: ArrayLike) -> Array:
    """The rotation that turns by the second quaternion, then by the first, shape [..., 4]."""
    ax, ay, az, aw = np.moveaxis(np.asarray(first, np.float64), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(second, np.float64), -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def angles_between(first: ArrayLike, second: ArrayLike) -> Array:
    """Angle of the turn from each quaternion to another [rad], 0 to pi, shape [...]."""
    cosine = np.abs(np.sum(np.asarray(first, np.float64) * np.asarray(second, np.float64), axis=-1))
    return 2.0 * np.arccos(np.clip(cosine, 0.0, 1.0))


def slerp(first: ArrayLike, second: ArrayLike, share: ArrayLike) -> Array:
    """Spherical linear interpolation the short way round (Shoemake, 10.1145/325334.325242).

    Args:
        first: Unit quaternions at share 0, shape [..., 4].
        second: Unit quaternions at share 1, shape [..., 4].
        share: How far to go, shape [...].
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    share = np.asarray(share, np.float64)[..., None]
    cosine = np.sum(first * second, axis=-1, keepdims=True)
    second = np.where(cosine < 0.0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    small = sine < 1e-6
    safe = np.where(small, 1.0, sine)
    one = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    other = np.where(small, share, np.sin(share * angle) / safe)
    result = one * first + other * second
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


def cross(first: ArrayLike, second: ArrayLike) -> Array:
    """The cross product of two vectors, shape [3]: numpy's own takes ten times as long for one."""
    ax, ay, az = np.asarray(first, np.float64).tolist()
    bx, by, bz = np.asarray(second, np.float64).tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def shortest_turn(start: ArrayLike, end: ArrayLike) -> Array:
    """The rotation matrix of the smallest turn from one unit vector to another, shape [3, 3]."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    cosine = float(start @ end)
    if cosine < -0.999999:
        # Any axis square to the vector does.
        axis = cross(start, np.eye(3)[np.argmin(np.abs(start))])
        axis /= np.linalg.norm(axis)
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    x, y, z = cross(start, end).tolist()
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + cosine)


def fitted_rotation(start: ArrayLike, end: ArrayLike) -> Array:
    """The rotation that lays points best on others, about their means (Kabsch 1976), shape [3, 3].

    Args:
        start: Points, shape [N, 3].
        end: Where they are to be, shape [N, 3].
    """
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    covariance = (end - end.mean(axis=0)).T @ (start - start.mean(axis=0))
    left, _, right = np.linalg.svd(covariance)
    left[:, -1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
    return left @ right
