# SPDX-License-Identifier: GPL-3.0-or-later
"""Parses the Leap service's JSON, protocol 6, and recordings of it (LeapJS Playback).

Units are millimeters and microseconds; Y is up, +Z points towards the user. A hand has the joints
mcp, pip, dip and tip of each finger, and the palm. Older services give neither the wrist nor the
metacarpals; these are inferred.
"""

from __future__ import annotations

import gzip
import json
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import TrackingError
from ..hand.skeleton import SkeletonError, complete_hand
from ..protocol.joints import ALL_JOINTS, FINGERS, JOINT_COUNT, PALM, SIDES, WRIST, reference_hand
from ..protocol.packet import HandFrame

_JOINT_KEYS = ("mcpPosition", "pipPosition", "dipPosition", "tipPosition")
_INFERRED = sum(1 << joint for joint in (WRIST, *(finger[0] for finger in FINGERS[1:])))
"""Bits of the joints that older services do not send."""
_MAX_FILE_SIZE = 1 << 30
"""Largest size of an unpacked .json.gz that is read [bytes]."""


class LeapHands:
    """Converts the service's frames to hands, in order.

    If a frame has two hands of one side, the one with the id used so far is kept, otherwise the
    one with the higher confidence. Invalid frames and hands are counted, not raised.
    """

    def __init__(self) -> None:
        """Start without hands."""
        self.rejected = 0
        """Number of frames and hands that could not be read."""
        self.time: int | None = None
        """Time of the last message [ns]; None if it was not a valid frame."""
        self._identity: dict[str, Any] = {}

    def read(self, message: Any) -> list[HandFrame]:
        """Return the hands in a frame, at most one per side; empty if it is not a valid frame.

        Args:
            message: The parsed JSON.
        """
        self.time = None
        try:
            time = round(_number(message["timestamp"]) * 1000)
            entries = _records(message["hands"])
            pointables = _records(message.get("pointables", ()))
            if not 0 <= time < 1 << 62:
                raise SkeletonError("bad timestamp")
        except (TypeError, KeyError, AttributeError, ValueError, OverflowError):
            if not (isinstance(message, Mapping) and ("version" in message or "event" in message)):
                self.rejected += 1
            return []
        self.time = time
        found: dict[str, tuple[tuple[bool, float], Any, HandFrame]] = {}
        for entry in entries:
            try:
                frame = _hand(entry, pointables, time)
            except (TypeError, KeyError, AttributeError, ValueError, OverflowError):
                self.rejected += 1
                continue
            identity = entry.get("id")
            rank = (self._identity.get(frame.side) == identity, frame.confidence)
            if frame.side not in found or rank > found[frame.side][0]:
                found[frame.side] = (rank, identity, frame)
        for side, (_, identity, _) in found.items():
            self._identity[side] = identity
        return [frame for _, _, frame in found.values()]


def read_leap_file(path: Path) -> list[tuple[int, list[HandFrame]]]:
    """Read the time [ns] and the hands of each frame of a file, sorted by time.

    Args:
        path: A LeapJS Playback recording, .json or .json.gz, protocol 6.

    Raises:
        TrackingError: The file cannot be read, or contains no hands.
    """
    try:
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            with gzip.open(path) as file:
                data = file.read(_MAX_FILE_SIZE)
        content = json.loads(data)
    except (OSError, EOFError, zlib.error) as error:
        raise TrackingError(f"{path} cannot be read ({error}).") from error
    except (ValueError, RecursionError) as error:
        raise TrackingError(
            f"{path} is not valid JSON; expected a LeapJS Playback recording."
        ) from error
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise TrackingError(f"{path} has no list of frames; expected a LeapJS Playback recording.")
    hands = LeapHands()
    read = []
    for message in _unpacked(frames):
        found = hands.read(message)
        time = hands.time
        if time is not None:
            read.append((time, found))
    if not any(found for _, found in read):
        raise TrackingError(f"None of the {len(frames)} frames in {path} has a readable hand.")
    read.sort(key=lambda item: item[0])
    return read


def _unpacked(frames: list[Any]) -> Iterator[Any]:
    """Yield the frames of a file. Later versions of the format store values without their keys.

    There the first frame holds the keys in place of the values, with the same nesting.
    """
    if not frames or not isinstance(frames[0], list):
        yield from frames
        return
    for packed in frames[1:]:
        try:
            yield _named(frames[0], packed)
        except (TypeError, IndexError, ValueError, AttributeError, RecursionError):
            yield packed


def _named(names: Any, values: Any) -> Any:
    """Combine keys and values; a nested list of keys applies to every item of a list of values."""
    if len(names) == 1 and isinstance(names[0], list):
        return [_named(names[0], value) for value in values]
    result = {}
    for name, value in zip(names, values, strict=False):
        if isinstance(name, str):
            # Null means that the device did not provide the value.
            if value is not None:
                result[name] = value
        else:
            ((key, inner),) = name.items()
            result[key] = _named(inner, value)
    return result


def _hand(entry: Mapping[str, Any], pointables: list[Mapping[str, Any]], time: int) -> HandFrame:
    side = str(entry["type"]).lower()
    if side not in SIDES:
        raise SkeletonError("bad side")
    positions = np.full((JOINT_COUNT, 3), np.nan)
    radii = np.full(JOINT_COUNT, np.nan)
    reference = reference_hand(side)
    inferred = _INFERRED
    for pointable in pointables:
        if pointable.get("handId") != entry["id"] or pointable.get("tool"):
            continue
        # Some recordings lack the type; it is also the last digit of the id.
        kind = pointable["type"] if "type" in pointable else pointable["id"] % 10
        if kind not in range(5):
            raise SkeletonError("bad finger")
        finger = FINGERS[kind]
        # The thumb's "mcp" is the base of its metacarpal.
        chain = list(finger[-4:])
        for joint, key in zip(chain, _JOINT_KEYS, strict=True):
            positions[joint] = _vector(pointable[key]) * 1e-3
        if kind and "carpPosition" in pointable:
            positions[finger[0]] = _vector(pointable["carpPosition"]) * 1e-3
            inferred &= ~(1 << finger[0])
        # There is one width per finger; the reference hand provides the taper.
        taper = reference.radii[chain]
        width = _number(pointable.get("width", math.nan))
        radii[chain] = 0.5e-3 * width * taper / taper.mean()
    if "wrist" in entry:
        positions[WRIST] = _vector(entry["wrist"]) * 1e-3
        inferred &= ~(1 << WRIST)
    positions[PALM] = _vector(entry["palmPosition"]) * 1e-3
    rotation = palm_axes(_vector(entry["direction"]), _vector(entry["palmNormal"]))
    joints = complete_hand(positions, side, palm_rotation=rotation, radii=radii)
    frame = HandFrame(
        side=side,
        source_time=time,
        source="leap",
        confidence=min(1.0, max(0.0, _number(entry.get("confidence", 1.0)))),
        tracked=ALL_JOINTS & ~inferred,
        joints=joints,
    )
    if not np.isfinite(frame.confidence):
        return replace(frame, confidence=0.0)
    return frame


def palm_axes(
    direction: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """The palm's OpenXR axes as columns, shape [3, 3]; None if Leap's vectors are unusable.

    Args:
        direction: Unit vector from the palm to the fingers.
        normal: Unit vector out of the palm.
    """
    back, up = -direction, -normal
    length = np.linalg.norm(back)
    if not 0.9 < length < 1.1:
        return None
    back /= length
    up -= back * (back @ up)
    height = np.linalg.norm(up)
    if not 0.5 < height < 1.1:
        return None
    up /= height
    return np.stack([np.cross(up, back), up, back], axis=1)


def _records(value: Any) -> list[Mapping[str, Any]]:
    if not isinstance(value, list | tuple):
        raise TypeError("not a list")
    return [item for item in value if isinstance(item, Mapping)]


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("not a number")
    return float(value)


def _vector(value: Any) -> NDArray[np.float64]:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise TypeError("not a vector")
    vector = np.array([_number(item) for item in value])
    if not (np.isfinite(vector).all() and np.abs(vector).max() < 1e6):
        raise ValueError("a position that is not finite, or too far away")
    return vector
