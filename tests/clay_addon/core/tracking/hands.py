# SPDX-License-Identifier: GPL-3.0-or-later
"""Test data for tracking: generated and recorded hands, and a manual clock."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_clay.clay_addon.core.tracking.hand.presence import TrackedHand
from tactile_clay.clay_addon.core.tracking.hand.retarget import Z_UP
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    JOINT_COUNT,
    JOINT_NAMES,
    reference_hand,
)
from tactile_clay.clay_addon.core.tracking.protocol.packet import HandFrame, joint_array
from tactile_clay.solver.geometry.rotations import (
    matrices_from_quaternions,
    product,
    quaternions_from_matrices,
)
from tactile_clay.solver.hand.shape import POSES, hand_shape

__all__ = [
    "POSES",
    "Clock",
    "flat_hand",
    "frame_at",
    "hand_shape",
    "leap_recordings",
    "rig_bones",
    "shown",
]

MILLISECOND = 1_000_000
LEAP_RECORDINGS = Path(__file__).resolve().parents[5] / "shared" / "data" / "leap"


class Clock:
    """A clock that advances only by `turn` [ns]."""

    def __init__(self, now: int = 10_000 * MILLISECOND) -> None:
        self.now = now

    def __call__(self) -> int:
        return self.now

    def turn(self, milliseconds: float) -> int:
        self.now += round(milliseconds * MILLISECOND)
        return self.now


def shown(hand: TrackedHand | None) -> TrackedHand:
    """The hand, asserting that there is one."""
    assert hand is not None
    return hand


def flat_hand(
    side: str = "right",
    at: ArrayLike = (0.0, 0.2, 0.0),
    *,
    quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    size: float = 1.0,
) -> NDArray[np.float32]:
    """Joints of a flat hand with its wrist at a position, rotated and scaled, shape [26, 8]."""
    reference = reference_hand(side)
    turn = matrices_from_quaternions(quaternion)
    return joint_array(
        np.asarray(at) + size * reference.positions @ turn.T,
        product(quaternion, quaternions_from_matrices(reference.rotations)),
        size * reference.radii,
    )


def frame_at(
    time: int, sequence: int = 1, side: str = "right", at: ArrayLike = (0.0, 0.2, 0.0), **options
) -> HandFrame:
    """A frame of a flat hand; other fields can be overridden."""
    values = {
        "side": side,
        "source_time": time,
        "sequence": sequence,
        "source": "leap",
        "joints": flat_hand(side, at),
    }
    return HandFrame(**{**values, **options})


def rig_bones(
    side: str = "right", *, name: Callable[[str], str] = str, size: float = 1.0
) -> dict[str, NDArray[np.float64]]:
    """Rest matrices of a rig with OpenXR's axes, Z up, by bone name, shape [4, 4]."""
    reference = reference_hand(side)
    bones = {}
    for joint in range(JOINT_COUNT):
        matrix = np.eye(4)
        matrix[:3, :3] = Z_UP @ reference.rotations[joint]
        matrix[:3, 3] = size * Z_UP @ reference.positions[joint]
        bones[name(JOINT_NAMES[joint])] = matrix
    return bones


def leap_recordings() -> list[Path]:
    """Real recordings of a Leap, if available."""
    return sorted(LEAP_RECORDINGS.glob("*.json.gz"))
