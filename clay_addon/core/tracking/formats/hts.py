# SPDX-License-Identifier: GPL-3.0-or-later
"""Parses the text that Hand Tracking Streamer sends from a Meta Quest.

UTF-8 text; each hand has a line for the wrist and one for 21 landmarks (see its CONNECTIONS.md):

    Right wrist:, x, y, z, qx, qy, qz, qw
    Right landmarks:, x, y, z, … (21 points in the wrist's axes)

Units are meters in Unity's left-handed axes: X right, Y up, Z forward. The wrist's Z points to the
fingers and its Y out of the back of the hand. The app gives no confidence.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .....solver.geometry.rotations import matrices_from_quaternions
from ..hand.skeleton import complete_hand
from ..protocol.joints import ALL_JOINTS, FINGERS, JOINT_COUNT, PALM, SIDES, WRIST
from ..protocol.packet import HandFrame

_LANDMARKS = [WRIST, *(joint for finger in FINGERS for joint in finger[-4:])]
_INFERRED = sum(1 << joint for joint in (PALM, *(finger[0] for finger in FINGERS[1:])))
"""Bits of the joints that the app does not send."""
_MAX_WRIST_AGE = 50_000_000
"""Landmarks use the last wrist if it is no older than this [ns]."""
_MAX_DATAGRAM_SIZE = 1 << 16
_MIRROR = np.array([1.0, 1.0, -1.0])


class HtsHands:
    """Combines wrists and landmarks into hands. Bad lines are counted, not raised."""

    def __init__(self) -> None:
        """Start without any wrist."""
        self.rejected = 0
        """Number of lines and hands that could not be read."""
        self._wrists: dict[str, tuple[int, NDArray[np.float64]]] = {}

    def read(self, data: bytes, now: int) -> list[HandFrame]:
        """Return the hands that a datagram completes.

        Args:
            data: The datagram.
            now: When it arrived, on this machine's clock [ns].
        """
        if len(data) > _MAX_DATAGRAM_SIZE:
            self.rejected += 1
            return []
        frames = []
        for line in data.decode("utf-8", "replace").splitlines():
            if not line.strip():
                continue
            try:
                frame = self._line(line, now)
            except (ValueError, OverflowError):
                self.rejected += 1
                continue
            if frame is not None:
                frames.append(frame)
        return frames

    def _line(self, line: str, now: int) -> HandFrame | None:
        label, colon, rest = line.partition(":")
        # Newer versions append a frame number and a time after a vertical bar.
        words = label.partition("|")[0].lower().split()
        if not colon or len(words) != 2:
            raise ValueError("no label")
        if words[0] == "head":
            return None
        side, kind = words
        if side not in SIDES:
            raise ValueError("bad side")
        values = np.array([float(value) for value in rest.split(",") if value.strip()])
        if not np.isfinite(values).all() or (values.size and np.abs(values).max() > 100.0):
            raise ValueError("bad values")
        if kind == "wrist":
            if len(values) != 7 or abs(np.linalg.norm(values[3:]) - 1.0) > 0.02:
                raise ValueError("bad wrist")
            self._wrists[side] = (now, values)
            return None
        if kind != "landmarks" or len(values) != 63:
            raise ValueError("bad landmarks")
        arrived, wrist = self._wrists.get(side, (0, values))
        if len(wrist) != 7 or now - arrived > _MAX_WRIST_AGE:
            raise ValueError("landmarks without a wrist")
        return _frame(side, wrist, values.reshape(21, 3), now)


def _frame(
    side: str, wrist: NDArray[np.float64], landmarks: NDArray[np.float64], now: int
) -> HandFrame:
    quaternion = wrist[3:] / np.linalg.norm(wrist[3:])
    # Mirroring Z reverses rotations about X and Y.
    rotation = matrices_from_quaternions(quaternion * np.array([-1.0, -1.0, 1.0, 1.0]))
    positions = np.full((JOINT_COUNT, 3), np.nan)
    positions[_LANDMARKS] = wrist[:3] * _MIRROR + (landmarks * _MIRROR) @ rotation.T
    return HandFrame(
        side=side,
        source_time=now,
        source="hts",
        tracked=ALL_JOINTS & ~_INFERRED,
        joints=complete_hand(positions, side, palm_rotation=rotation),
    )
