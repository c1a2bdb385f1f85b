# SPDX-License-Identifier: GPL-3.0-or-later
"""The way of a hand's bones through a step: rotations turn evenly, joints go straight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.polar import rotation_and_stretch

Array = NDArray[np.float64]


class BonePath:
    """Bones between the poses of two steps.

    Args:
        rest: World from each bone's own coordinates at rest, shape [B, 4, 4].
    """

    def __init__(self, rest: Array) -> None:
        self._rest_inverse = np.linalg.inv(rest)
        self._rest_turn = quaternions(_split(rest[:, :3, :3])[0])
        self.start = rest.copy()
        """Poses at the end of the last step, shape [B, 4, 4]."""
        self.end = rest.copy()
        """Poses at the end of this step."""
        self._prepare()

    def aim(self, end: Array) -> None:
        """Plan the way from where bones are to their next poses, shape [B, 4, 4]."""
        self.end = end.copy()
        self._prepare()

    def arrive(self) -> None:
        """Start the next way from the end of this."""
        self.start = self.end.copy()

    def _prepare(self) -> None:
        first, self._first_stretch = _split(self.start[:, :3, :3])
        last, self._last_stretch = _split(self.end[:, :3, :3])
        self._first, last_turn = quaternions(first), quaternions(last)
        cosine = np.einsum("bi,bi->b", self._first, last_turn)
        self._last = np.where(cosine[:, None] < 0.0, -last_turn, last_turn)
        self._angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))[:, None]

    def poses(self, fraction: float) -> tuple[Array, Array]:
        """Where bones are after a fraction of the way.

        Returns:
            Poses, shape [B, 4, 4], and how each is turned from rest, as quaternions (x, y, z, w),
            shape [B, 4].
        """
        sine = np.sin(self._angle)
        small = sine < 1e-6
        safe = np.where(small, 1.0, sine)
        before = np.where(small, 1.0 - fraction, np.sin((1.0 - fraction) * self._angle) / safe)
        after = np.where(small, fraction, np.sin(fraction * self._angle) / safe)
        turn = self._first * before + self._last * after
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        stretch = self._first_stretch + (self._last_stretch - self._first_stretch) * fraction
        poses = np.zeros_like(self.end)
        poses[:, :3, :3] = rotations(turn) @ stretch
        poses[:, :3, 3] = self.start[:, :3, 3] + fraction * (
            self.end[:, :3, 3] - self.start[:, :3, 3]
        )
        poses[:, 3, 3] = 1.0
        return poses, product(turn, conjugate(self._rest_turn))

    def turns(self, poses: Array) -> Array:
        """World at present from world at rest, by bone, shape [B, 4, 4]."""
        return poses @ self._rest_inverse


def _split(linear: Array) -> tuple[Array, Array]:
    """Rotations and stretches of linear maps, shape [B, 3, 3] each."""
    gram = np.swapaxes(linear, 1, 2) @ linear
    rotation, stretch = linear.copy(), np.tile(np.eye(3), (len(linear), 1, 1))
    # Most bones are rigid, up to rounding.
    for bone in np.flatnonzero(np.abs(gram - np.eye(3)).max((1, 2)) > 1e-6):
        rotation[bone], stretch[bone] = rotation_and_stretch(linear[bone])
    return rotation, stretch


def quaternions(rotation: Array) -> Array:
    """Unit quaternions (x, y, z, w) of rotation matrices, shape [B, 4]."""
    m = np.moveaxis(rotation, 0, -1)
    x, y, z = m[0, 0], m[1, 1], m[2, 2]
    xy, yz, zx = m[0, 1] + m[1, 0], m[1, 2] + m[2, 1], m[0, 2] + m[2, 0]
    xw, yw, zw = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    # Each row is the quaternion times one of its components; the largest loses least.
    rows = np.array(
        [
            [1.0 + x - y - z, xy, zx, xw],
            [xy, 1.0 - x + y - z, yz, yw],
            [zx, yz, 1.0 - x - y + z, zw],
            [xw, yw, zw, 1.0 + x + y + z],
        ]
    )
    largest = np.einsum("iib->ib", rows).argmax(0)
    chosen = rows[largest, :, np.arange(len(rotation))]
    return chosen / np.linalg.norm(chosen, axis=1, keepdims=True)


def rotations(quaternion: Array) -> Array:
    """Rotation matrices of unit quaternions (x, y, z, w), shape [B, 3, 3]."""
    x, y, z, w = quaternion.T
    return np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        ),
        -1,
        0,
    )


def conjugate(quaternion: Array) -> Array:
    """Inverse of unit quaternions, shape [B, 4]."""
    return quaternion * np.array((-1.0, -1.0, -1.0, 1.0))


def product(first: Array, second: Array) -> Array:
    """Turn by the second quaternions, then by the first, shape [B, 4]."""
    a, b = first[:, :3], second[:, :3]
    v, w = first[:, 3:], second[:, 3:]
    return np.concatenate(
        [v * b + w * a + np.cross(a, b), v * w - np.einsum("bi,bi->b", a, b)[:, None]], axis=1
    )
