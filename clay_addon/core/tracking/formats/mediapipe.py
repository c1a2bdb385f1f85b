# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in space from MediaPipe's landmarks of a picture.

MediaPipe gives each hand twice: where its 21 landmarks are in the picture, and a hand in meters
about its own middle. Laid in front of a camera so that it covers the picture's landmarks, the hand
gets its place in space. What it gets no better than MediaPipe guesses it is its distance, and its
size, which breathes: retargeting lays it on bones of fixed length.
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
_GUESSED = sum(1 << joint for joint in (PALM, *(finger[0] for finger in FINGERS[1:])))
FIELD_OF_VIEW = 65.0
"""Across the picture [degrees]: that of most webcams."""

# The camera looks at the person: its right is the person's left, its depth the way to the person.
_PERSON_FROM_CAMERA = np.array([-1.0, -1.0, 1.0])


class MediapipeHands:
    """Turns the worker's lines into hands. Nothing is raised: what is no hand is counted."""

    def __init__(self, *, field_of_view: float = FIELD_OF_VIEW, mirrored: bool = False) -> None:
        """Set up for a camera.

        Args:
            field_of_view: Across the picture [degrees].
            mirrored: Whether the pictures are mirrored, as some cameras' drivers do.
        """
        self.rejected = 0
        """Lines and hands that could not be read."""
        self.time: int | None = None
        """Time of the picture that was read last [ns]; None where it was none."""
        self._slope = 2.0 * math.tan(math.radians(field_of_view) / 2.0)
        self._mirrored = mirrored

    def read(self, line: str) -> list[HandFrame]:
        """The hands in a picture, at most one of each side, the surer one."""
        self.time = None
        try:
            record = json.loads(line)
            time, width, height = (int(record[key]) for key in ("time", "width", "height"))
            entries = list(record["hands"])
            if not (0 <= time < 1 << 62 and width > 0 and height > 0):
                raise ValueError("bad picture")
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
            # In a mirrored picture MediaPipe takes each hand for the other.
            side = SIDES[1 - SIDES.index(side)]
            image = image * [-1.0, 1.0] + [1.0, 0.0]
            world = world * [-1.0, 1.0, 1.0]
        rays = (image - 0.5) * [self._slope, self._slope * aspect]
        points = np.full((JOINT_COUNT, 3), np.nan)
        points[_LANDMARKS] = (world + _placed(world, rays)) * _PERSON_FROM_CAMERA
        return HandFrame(
            side=side,
            source_time=time,
            source="mediapipe",
            confidence=min(1.0, max(0.0, float(entry["score"]))),
            tracked=ALL_JOINTS & ~_GUESSED,
            joints=complete_hand(points, side),
        )


def _placed(world: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a hand is so that each point lies on its ray, as nearly as can be [m], shape [3].

    Args:
        world: Points about the hand's middle [m], shape [N, 3]; Z away from the camera.
        rays: Slopes of the ray through each point in the picture, shape [N, 2].
    """
    # (x + tx) = u (z + tz) for each coordinate: linear in the shift.
    count = len(world)
    matrix = np.zeros((2 * count, 3))
    matrix[:count, 0] = matrix[count:, 1] = 1.0
    matrix[:, 2] = -rays.T.ravel()
    right = (rays * world[:, 2:] - world[:, :2]).T.ravel()
    shift = np.linalg.lstsq(matrix, right, rcond=None)[0]
    if not (np.isfinite(shift).all() and 0.05 < shift[2] < 5.0):
        raise SkeletonError("the hand is not in front of the camera")
    return shift
