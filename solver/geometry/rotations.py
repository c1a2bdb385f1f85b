# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations in NumPy, many at a time: quaternions, matrices, rotation vectors and frames.

Quaternions are unit quaternions in the order (x, y, z, w); q and -q are the same rotation. Matrices
act on column vectors: ``matrix @ vector``. A rotation vector points along the axis and is as long
as the angle [rad]. Turns are counter-clockwise seen from the tip of the axis. Functions whose
shapes begin with ``...`` take any number of leading dimensions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def matrices_from_quaternions(quaternions: ArrayLike) -> Array:
    """Rotation matrices of unit quaternions, shape [..., 4] to [..., 3, 3]."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def quaternions_from_matrices(matrices: ArrayLike) -> Array:
    """Unit quaternions with w >= 0 of rotation matrices, shape [..., 3, 3] to [..., 4]."""
    m = np.moveaxis(np.asarray(matrices, np.float64), (-2, -1), (0, 1))
    x, y, z = m[0, 0], m[1, 1], m[2, 2]
    xy, yz, zx = m[0, 1] + m[1, 0], m[1, 2] + m[2, 1], m[0, 2] + m[2, 0]
    xw, yw, zw = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    # Each row is the quaternion times four times one of its components; the largest loses least.
    rows = np.array(
        [
            [1.0 + x - y - z, xy, zx, xw],
            [xy, 1.0 - x + y - z, yz, yw],
            [zx, yz, 1.0 - x - y + z, zw],
            [xw, yw, zw, 1.0 + x + y + z],
        ]
    )
    largest = np.einsum("ii...->i...", rows).argmax(0)
    chosen = np.take_along_axis(rows, largest[None, None], axis=0)[0]
    quaternions = np.moveaxis(chosen, 0, -1)
    quaternions = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return np.where(quaternions[..., 3:] < 0.0, -quaternions, quaternions)


def matrices_from_rotation_vectors(vectors: ArrayLike) -> Array:
    """Rotation matrices of rotation vectors [rad], shape [..., 3] to [..., 3, 3] (Rodrigues)."""
    vectors = np.asarray(vectors, np.float64)
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(vectors / np.maximum(angle, 1e-12), -1, 0)
    zero = np.zeros_like(x)
    skew = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))
    sine, versine = np.sin(angle)[..., None], (1.0 - np.cos(angle))[..., None]
    return np.eye(3) + sine * skew + versine * (skew @ skew)


def rotation_vectors_from_matrices(matrices: ArrayLike) -> Array:
    """Rotation vectors [rad], no longer than pi, of rotation matrices, [..., 3, 3] to [..., 3]."""
    quaternions = quaternions_from_matrices(matrices)
    along = quaternions[..., :3]
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, quaternions[..., 3:])
    return np.where(length < 1e-12, 0.0, along * (angle / np.maximum(length, 1e-12)))


def conjugate(quaternions: ArrayLike) -> Array:
    """Inverses of unit quaternions, shape [..., 4]."""
    return np.asarray(quaternions, np.float64) * np.array((-1.0, -1.0, -1.0, 1.0))


def product(first: ArrayLike, second: ArrayLike) -> Array:
    """The rotation by the second quaternion followed by that of the first, shape [..., 4]."""
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
    """Angle between each quaternion of the first and the second [rad], 0 to pi, shape [...]."""
    cosine = np.abs(np.sum(np.asarray(first, np.float64) * np.asarray(second, np.float64), axis=-1))
    return 2.0 * np.arccos(np.clip(cosine, 0.0, 1.0))


def slerp(first: ArrayLike, second: ArrayLike, fraction: ArrayLike) -> Array:
    """Spherical linear interpolation along the shorter arc (Shoemake, 10.1145/325334.325242).

    Args:
        first: Unit quaternions at fraction 0, shape [..., 4].
        second: Unit quaternions at fraction 1, shape [..., 4].
        fraction: 0 to 1, shape [...].
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    fraction = np.asarray(fraction, np.float64)[..., None]
    cosine = np.sum(first * second, axis=-1, keepdims=True)
    second = np.where(cosine < 0.0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    small = sine < 1e-6
    safe = np.where(small, 1.0, sine)
    one = np.where(small, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe)
    other = np.where(small, fraction, np.sin(fraction * angle) / safe)
    result = one * first + other * second
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


def cross(first: ArrayLike, second: ArrayLike) -> Array:
    """Cross product of two vectors, shape [3], ten times as fast as NumPy's for a single pair."""
    ax, ay, az = np.asarray(first, np.float64).tolist()
    bx, by, bz = np.asarray(second, np.float64).tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def shortest_turn(start: ArrayLike, end: ArrayLike) -> Array:
    """Matrix of the smallest rotation from one unit vector to another, shape [3, 3]."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    cosine = float(start @ end)
    if cosine < -0.999999:
        # Half a turn about any axis perpendicular to the vector.
        axis = cross(start, np.eye(3)[np.argmin(np.abs(start))])
        axis /= np.linalg.norm(axis)
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    x, y, z = cross(start, end).tolist()
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + cosine)


def fitted_rotation(start: ArrayLike, end: ArrayLike) -> Array:
    """Rotation about the mean that best aligns points with others (Kabsch 1976), shape [3, 3].

    Never a reflection, even if one would fit better.

    Args:
        start: Points, shape [N, 3].
        end: Their target positions, shape [N, 3].
    """
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    covariance = (end - end.mean(axis=0)).T @ (start - start.mean(axis=0))
    left, _, right = np.linalg.svd(covariance)
    left[:, -1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
    return left @ right


def rotation_and_stretch(linear: ArrayLike) -> tuple[Array, Array]:
    """Polar decomposition ``linear = rotation @ stretch``; reflections go into the stretch.

    Args:
        linear: A non-singular matrix, shape [3, 3].
    """
    left, scales, right = np.linalg.svd(np.asarray(linear, np.float64))
    rotation = left @ right
    stretch = right.T @ np.diag(scales) @ right
    return (rotation, stretch) if np.linalg.det(rotation) > 0 else (-rotation, -stretch)


def tangent_of(direction: Array, normal: Array, fallback: Array) -> Array:
    """Unit vector along a direction's component perpendicular to a unit normal, shape [3].

    If the direction is along the normal, the fallback is used instead.
    """
    for vector in (direction, fallback, np.eye(3)[np.argmin(np.abs(normal))]):
        flat = vector - (vector @ normal) * normal
        size = float(np.linalg.norm(flat))
        if size > 1e-3 * max(float(np.linalg.norm(vector)), 1e-9):
            return np.asarray(flat / size)
    raise AssertionError("no axis is perpendicular enough to the normal")


def frame_of(normal: Array, tangent: Array) -> Array:
    """Rotation with a unit normal as Z, and Y as close to a tangent as possible, shape [3, 3]."""
    y = tangent_of(tangent, normal, tangent)
    return np.column_stack((cross(y, normal), y, normal))


def turned_towards(rotation: Array, target: Array, max_angle: float) -> Array:
    """Turn a rotation towards another by at most an angle [rad], shape [3, 3].

    The axis of half a turn is ambiguous: the rotation's Z is used.
    """
    vector = rotation_vectors_from_matrices(target @ rotation.T)
    angle = float(np.linalg.norm(vector))
    if angle <= max_angle:
        return target
    # Near half a turn the axis is lost in rounding.
    axis = rotation[:, 2] if angle > np.pi - 1e-9 else vector / angle
    return matrices_from_rotation_vectors(axis * max_angle) @ rotation
