# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands from the Leap service's JSON, protocol 6, and from files of it (LeapJS Playback).

Millimeters and microseconds, Y up, +Z towards the person; joints mcp, pip, dip and tip of each
finger, and the palm. Older services give neither wrist nor metacarpals; those are derived.
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
_GUESSED = sum(1 << joint for joint in (WRIST, *(finger[0] for finger in FINGERS[1:])))
_MAX_FILE_SIZE = 1 << 30


class LeapHands:
    """Turns the service's frames into hands, one after the other.

    Of two hands that both claim to be the same, the one that has been it before is believed, then
    the surer one. Whatever a frame holds, nothing is raised: what is no hand is counted.
    """

    def __init__(self) -> None:
        """Begin without hands."""
        self.rejected = 0
        """Frames and hands that could not be read."""
        self.time: int | None = None
        """Time of the frame that was read last [ns]; None where it was none."""
        self._identity: dict[str, Any] = {}

    def read(self, message: Any) -> list[HandFrame]:
        """The hands in a frame, at most one of each side; none where it is not a frame.

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
    """Time [ns] and hands of each frame of a file, in the order of their times.

    Args:
        path: A .json or .json.gz file of LeapJS Playback, protocol 6.

    Raises:
        TrackingError: The file cannot be read, or holds no frames.
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
            f"{path} is no JSON; expected a recording of LeapJS Playback."
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
        raise TrackingError(f"{path} holds no hand that can be read, in {len(frames)} frames.")
    read.sort(key=lambda item: item[0])
    return read


def _unpacked(frames: list[Any]) -> Iterator[Any]:
    """The frames of a file, whose later versions keep values without their names.

    There the first frame has the names in place of the values, nested as the values are.
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
    """Values with their names; names in a list of their own are those of every value."""
    if len(names) == 1 and isinstance(names[0], list):
        return [_named(names[0], value) for value in values]
    result = {}
    for name, value in zip(names, values, strict=False):
        if isinstance(name, str):
            # A value that the device did not give is kept as null.
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
    guessed = _GUESSED
    for pointable in pointables:
        if pointable.get("handId") != entry["id"] or pointable.get("tool"):
            continue
        # Some recordings lack the type, which is the last digit of the number.
        kind = pointable["type"] if "type" in pointable else pointable["id"] % 10
        if kind not in range(5):
            raise SkeletonError("bad finger")
        finger = FINGERS[kind]
        # The thumb has no mcp of its own: what is called so is the base of its metacarpal.
        chain = list(finger[-4:])
        for joint, key in zip(chain, _JOINT_KEYS, strict=True):
            positions[joint] = _vector(pointable[key]) * 1e-3
        if kind and "carpPosition" in pointable:
            positions[finger[0]] = _vector(pointable["carpPosition"]) * 1e-3
            guessed &= ~(1 << finger[0])
        # One width for the whole finger: the reference hand says how a finger tapers.
        taper = reference.radii[chain]
        width = _number(pointable.get("width", math.nan))
        radii[chain] = 0.5e-3 * width * taper / taper.mean()
    if "wrist" in entry:
        positions[WRIST] = _vector(entry["wrist"]) * 1e-3
        guessed &= ~(1 << WRIST)
    positions[PALM] = _vector(entry["palmPosition"]) * 1e-3
    rotation = palm_axes(_vector(entry["direction"]), _vector(entry["palmNormal"]))
    joints = complete_hand(positions, side, palm_rotation=rotation, radii=radii)
    frame = HandFrame(
        side=side,
        source_time=time,
        source="leap",
        confidence=min(1.0, max(0.0, _number(entry.get("confidence", 1.0)))),
        tracked=ALL_JOINTS & ~guessed,
        joints=joints,
    )
    if not np.isfinite(frame.confidence):
        return replace(frame, confidence=0.0)
    return frame


def palm_axes(
    direction: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """OpenXR's axes of the palm as columns, shape [3, 3]; None where Leap gives none of use.

    Args:
        direction: From the palm to the fingers, a unit vector.
        normal: Out of the palm, a unit vector.
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
