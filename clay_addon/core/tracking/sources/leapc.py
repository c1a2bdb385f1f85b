# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultraleap's LeapC library as a source of hands, by ctypes.

From the documented interface of LeapC (Gemini 5 and Hyperion 6): structures without gaps,
millimeters and microseconds, Y up, each finger with four bones from its metacarpal to its tip.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from ctypes import (
    POINTER,
    Structure,
    byref,
    c_float,
    c_int32,
    c_int64,
    c_uint32,
    c_uint64,
    c_void_p,
)
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import TrackingError
from ..formats.leap import palm_axes
from ..hand.skeleton import SkeletonError, complete_hand
from ..protocol.joints import ALL_JOINTS, FINGERS, JOINT_COUNT, PALM, SIDES, WRIST, reference_hand
from ..protocol.packet import HandFrame
from .sender import Sighting, sighting

_CONNECTED, _CONNECTION_LOST, _DEVICE, _TRACKING, _DEVICE_LOST = 1, 2, 3, 0x100, 0x104
_TIMEOUT = 0xE2010004
_FAILURE = 0x80000000
_POLL_MILLISECONDS = 100


class _Packed(Structure):
    _pack_ = 1
    _layout_ = "ms"


class Bone(_Packed):
    """LEAP_BONE."""

    _fields_ = [
        ("prev_joint", c_float * 3),
        ("next_joint", c_float * 3),
        ("width", c_float),
        ("rotation", c_float * 4),
    ]


class Digit(_Packed):
    """LEAP_DIGIT."""

    _fields_ = [("finger_id", c_int32), ("bones", Bone * 4), ("is_extended", c_uint32)]


class Palm(_Packed):
    """LEAP_PALM."""

    _fields_ = [
        ("position", c_float * 3),
        ("stabilized_position", c_float * 3),
        ("velocity", c_float * 3),
        ("normal", c_float * 3),
        ("width", c_float),
        ("direction", c_float * 3),
        ("orientation", c_float * 4),
    ]


class LeapHand(_Packed):
    """LEAP_HAND."""

    _fields_ = [
        ("id", c_uint32),
        ("flags", c_uint32),
        ("type", c_int32),
        ("confidence", c_float),
        ("visible_time", c_uint64),
        ("pinch_distance", c_float),
        ("grab_angle", c_float),
        ("pinch_strength", c_float),
        ("grab_strength", c_float),
        ("palm", Palm),
        ("digits", Digit * 5),
        ("arm", Bone),
    ]


class TrackingEvent(_Packed):
    """LEAP_TRACKING_EVENT, with its LEAP_FRAME_HEADER."""

    _fields_ = [
        ("reserved", c_void_p),
        ("frame_id", c_int64),
        ("timestamp", c_int64),
        ("tracking_frame_id", c_int64),
        ("hand_count", c_uint32),
        ("hands", POINTER(LeapHand)),
        ("framerate", c_float),
    ]


class Message(_Packed):
    """LEAP_CONNECTION_MESSAGE; older libraries leave the last field out."""

    _fields_ = [
        ("size", c_uint32),
        ("type", c_int32),
        ("event", c_void_p),
        ("device_id", c_uint32),
    ]


def leapc(
    library: str | None = None,
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
    tell: Callable[[str], None] = lambda text: print(text, file=sys.stderr, flush=True),
) -> Generator[Sighting, None, None]:
    """Hands from the Ultraleap tracking service, for as long as they are asked for.

    Args:
        library: Path of LeapC; looked for where Ultraleap's installers put it by default.
        clock: The time [ns].
        tell: Is told when the service or the device comes and goes.

    Raises:
        TrackingError: There is no LeapC, or it does not serve.
    """
    functions = load_library(library)
    connection = c_void_p()
    _check(functions.LeapCreateConnection(None, byref(connection)), "create a connection")
    try:
        _check(functions.LeapOpenConnection(connection), "open a connection")
        message = Message(size=ctypes.sizeof(Message))
        while True:
            code = functions.LeapPollConnection(connection, _POLL_MILLISECONDS, byref(message))
            code &= 0xFFFFFFFF
            if code == _TIMEOUT:
                yield sighting([])
                continue
            if code & _FAILURE:
                # Not connected yet, or not any more: the library keeps trying.
                yield sighting([])
                time.sleep(_POLL_MILLISECONDS * 1e-3)
                continue
            if message.type == _TRACKING and message.event:
                yield _sighting(functions, message.event, clock)
            else:
                _tell(message.type, tell)
    finally:
        functions.LeapCloseConnection(connection)
        functions.LeapDestroyConnection(connection)


def load_library(path: str | None = None) -> Any:
    """LeapC with the types of the functions that are called.

    Raises:
        TrackingError: It cannot be found or loaded, or is something else.
    """
    problems = []
    for candidate in [path] if path else _usual_places():
        try:
            functions = ctypes.CDLL(candidate)
            functions.LeapGetNow.restype = c_int64
            functions.LeapCreateConnection.argtypes = [c_void_p, POINTER(c_void_p)]
            functions.LeapOpenConnection.argtypes = [c_void_p]
            functions.LeapPollConnection.argtypes = [c_void_p, c_uint32, POINTER(Message)]
            functions.LeapCloseConnection.argtypes = [c_void_p]
            functions.LeapDestroyConnection.argtypes = [c_void_p]
            functions.LeapCloseConnection.restype = functions.LeapDestroyConnection.restype = None
        except (OSError, AttributeError) as error:
            problems.append(f"{candidate}: {error}")
        else:
            return functions
    raise TrackingError(
        "LeapC cannot be loaded. Install Ultraleap's hand tracking software, or name the library "
        f"with --library. Tried: {'; '.join(problems)}."
    )


def _usual_places() -> list[str]:
    if sys.platform == "win32":
        programs = os.environ.get("ProgramFiles", r"C:\Program Files")  # noqa: SIM112
        return [rf"{programs}\Ultraleap\LeapSDK\lib\x64\LeapC.dll", "LeapC.dll"]
    if sys.platform == "darwin":
        inside = "Contents/LeapSDK/lib/libLeapC.dylib"
        return [f"/Applications/Ultraleap Hand Tracking.app/{inside}", "libLeapC.dylib"]
    return [
        "/usr/lib/ultraleap-hand-tracking-service/libLeapC.so",
        "/opt/ultraleap/LeapSDK/lib/libLeapC.so",
        "libLeapC.so",
        "libLeapC.so.5",
    ]


def _check(code: int, what: str) -> None:
    code &= 0xFFFFFFFF
    if code & _FAILURE:
        raise TrackingError(f"LeapC could not {what} (code {code:#010x}).")


def _tell(kind: int, tell: Callable[[str], None]) -> None:
    texts = {
        _CONNECTED: "Connected to the Ultraleap service.",
        _CONNECTION_LOST: "The Ultraleap service is gone; waiting for it.",
        _DEVICE: "A tracking device is there.",
        _DEVICE_LOST: "The tracking device is gone.",
    }
    if kind in texts:
        tell(texts[kind])


def _sighting(functions: Any, event: int, clock: Callable[[], int]) -> Sighting:
    # The library owns the event until the next poll: everything is copied out of it here.
    tracking = TrackingEvent.from_address(event)
    # Both clocks run on this machine, so the frame's age says when it was on this one.
    age = max(0, functions.LeapGetNow() - tracking.timestamp) * 1000
    moment = clock() - age
    frames: dict[str, HandFrame] = {}
    for number in range(min(tracking.hand_count, 16)):
        with suppress(SkeletonError, ValueError):
            frame = hand_frame(tracking.hands[number], max(0, moment))
            frames.setdefault(frame.side, frame)
    return sighting(list(frames.values()), max(0, moment))


def hand_frame(hand: LeapHand, moment: int) -> HandFrame:
    """A hand of the library's.

    Args:
        hand: The structure.
        moment: When it was seen [ns].

    Raises:
        SkeletonError: Its joints make no hand.
    """
    if hand.type not in (0, 1):
        raise SkeletonError("bad side")
    side = SIDES[hand.type]
    positions = np.full((JOINT_COUNT, 3), np.nan)
    radii = np.full(JOINT_COUNT, np.nan)
    reference = reference_hand(side)
    for finger, digit in zip(FINGERS, hand.digits, strict=True):
        # The thumb's metacarpal has no length in Leap's model; its next bone is what OpenXR's is.
        bones = list(digit.bones)[5 - len(finger) :]
        for joint, bone in zip(finger, bones, strict=False):
            positions[joint] = _vector(bone.prev_joint)
            radii[joint] = 0.5e-3 * bone.width
        positions[finger[-1]] = _vector(bones[-1].next_joint)
        taper = reference.radii[finger[-1]] / reference.radii[finger[-2]]
        radii[finger[-1]] = radii[finger[-2]] * taper
    positions[WRIST] = _vector(hand.arm.next_joint)
    positions[PALM] = _vector(hand.palm.position)
    confidence = float(hand.confidence)
    return HandFrame(
        side=side,
        source_time=moment,
        source="leap",
        confidence=min(1.0, max(0.0, confidence)) if np.isfinite(confidence) else 0.0,
        tracked=ALL_JOINTS,
        joints=complete_hand(
            positions,
            side,
            palm_rotation=palm_axes(np.array(hand.palm.direction), np.array(hand.palm.normal)),
            radii=radii,
        ),
    )


def _vector(values: Any) -> NDArray[np.float64]:
    return np.array(list(values), np.float64) * 1e-3
