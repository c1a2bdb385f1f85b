# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in space from MediaPipe's landmarks.

MediaPipe gives each hand twice: 21 landmarks in the image, and 21 points in meters about the hand's
center. The hand is placed in front of the camera so that the points project onto the image's
landmarks. Its distance and size are only as good as MediaPipe's estimate, and the size fluctuates;
retargeting therefore uses bones of fixed length.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..hand.skeleton import SkeletonError, complete_hand
from ..protocol.joints import ALL_JOINTS, FINGERS, JOINT_COUNT, PALM, SIDES, WRIST
from ..protocol.packet import HandFrame

_LANDMARKS = [WRIST, *(joint for finger in FINGERS for joint in finger[-4:])]
_INFERRED = sum(1 << joint for joint in (PALM, *(finger[0] for finger in FINGERS[1:])))
"""Bits of the joints that MediaPipe does not detect."""
FIELD_OF_VIEW = 65.0
"""Horizontal field of view of most webcams [degrees]."""

# The camera faces the user: its X points to the user's left, its Y down, its Z to the user.
_USER_FROM_CAMERA = np.array([-1.0, -1.0, 1.0])


class MediapipeHands:
    """Converts the worker's lines to hands. Invalid lines and hands are counted, not raised."""

    def __init__(self, *, field_of_view: float = FIELD_OF_VIEW, mirrored: bool = False) -> None:
        """Set up for a camera.

        Args:
            field_of_view: Horizontal field of view [degrees].
            mirrored: Whether the camera's driver mirrors its images.
        """
        self.rejected = 0
        """Number of lines and hands that could not be read."""
        self.time: int | None = None
        """Time of the last image [ns]; None if its line was invalid."""
        self._slope = 2.0 * math.tan(math.radians(field_of_view) / 2.0)
        self._mirrored = mirrored

    def read(self, line: str) -> list[HandFrame]:
        """Return the hands in an image: for each side at most one, that of highest confidence."""
        self.time = None
        try:
            record = json.loads(line)
            time, width, height = (int(record[key]) for key in ("time", "width", "height"))
            entries = list(record["hands"])
            if not (0 <= time < 1 << 62 and width > 0 and height > 0):
                raise ValueError("bad image")
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            self.rejected += 1
            return []
        self.time = time
        found: dict[str, HandFrame] = {}
        for entry in entries:
            try:
                frame = self._hand(entry, time, height / width)
            except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
                self.rejected += 1
                continue
            if frame.side not in found or frame.confidence > found[frame.side].confidence:
                found[frame.side] = frame
        return list(found.values())

    def _hand(self, entry: Any, time: int, aspect: float) -> HandFrame:
        side = str(entry["side"]).lower()
        if side not in SIDES:
            raise SkeletonError("bad side")
        image = np.array(entry["image"], np.float64).reshape(21, 2)
        world = np.array(entry["world"], np.float64).reshape(21, 3)
        if not (np.isfinite(image).all() and np.isfinite(world).all()):
            raise SkeletonError("values that are not finite")
        if np.abs(image).max() > 10.0 or np.abs(world).max() > 1.0:
            raise SkeletonError("values that no hand has")
        if self._mirrored:
            # In a mirrored image MediaPipe mistakes each hand for the other.
            side = SIDES[1 - SIDES.index(side)]
            image = image * [-1.0, 1.0] + [1.0, 0.0]
            world = world * [-1.0, 1.0, 1.0]
        rays = (image - 0.5) * [self._slope, self._slope * aspect]
        points = np.full((JOINT_COUNT, 3), np.nan)
        points[_LANDMARKS] = (world + _fitted_center(world, rays)) * _USER_FROM_CAMERA
        return HandFrame(
            side=side,
            source_time=time,
            source="mediapipe",
            confidence=min(1.0, max(0.0, float(entry["score"]))),
            tracked=ALL_JOINTS & ~_INFERRED,
            joints=complete_hand(points, side),
        )


def _fitted_center(world: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """The hand's center for which its points best fit their rays (least squares) [m], shape [3].

    Args:
        world: Points about the hand's center [m], shape [N, 3]; Z points away from the camera.
        rays: Slopes of the ray through each landmark in the image, shape [N, 2].
    """
    # x + tx = u (z + tz), and likewise for y: linear in the center t.
    count = len(world)
    matrix = np.zeros((2 * count, 3))
    matrix[:count, 0] = matrix[count:, 1] = 1.0
    matrix[:, 2] = -rays.T.ravel()
    right = (rays * world[:, 2:] - world[:, :2]).T.ravel()
    center = np.linalg.lstsq(matrix, right, rcond=None)[0]
    if not (np.isfinite(center).all() and 0.05 < center[2] < 5.0):
        raise SkeletonError("the hand is not in front of the camera")
    return center
