# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultraleap's LeapC library as a source of hands, through ctypes.

Follows the documented interface of LeapC (Gemini 5 and Hyperion 6): structures without padding,
millimeters and microseconds, Y up, and four bones per finger from the metacarpal to the tip.
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
    """LEAP_CONNECTION_MESSAGE; older libraries lack the last field."""

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
    report: Callable[[str], None] = lambda text: print(text, file=sys.stderr, flush=True),
) -> Generator[Sighting, None, None]:
    """Yield the hands of the Ultraleap tracking service, without end.

    Args:
        library: Path of LeapC; by default searched for where Ultraleap's installers put it.
        clock: The time [ns].
        report: Receives messages when the service or the device connects or disconnects.

    Raises:
        TrackingError: LeapC cannot be loaded, or cannot connect.
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
                # Not connected yet, or disconnected: the library keeps trying.
                yield sighting([])
                time.sleep(_POLL_MILLISECONDS * 1e-3)
                continue
            if message.type == _TRACKING and message.event:
                yield _sighting(functions, message.event, clock)
            else:
                _report(message.type, report)
    finally:
        functions.LeapCloseConnection(connection)
        functions.LeapDestroyConnection(connection)


def load_library(path: str | None = None) -> Any:
    """Load LeapC and declare the types of the functions that are called.

    Args:
        path: Path of the library; searched for by default.

    Raises:
        TrackingError: It cannot be found or loaded, or is another library.
    """
    problems = []
    for candidate in [path] if path else _default_paths():
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
        "LeapC cannot be loaded. Install Ultraleap's hand tracking software, or give the path of "
        f"the library with --library. Tried: {'; '.join(problems)}."
    )


def _default_paths() -> list[str]:
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


def _check(code: int, action: str) -> None:
    code &= 0xFFFFFFFF
    if code & _FAILURE:
        raise TrackingError(f"LeapC could not {action} (code {code:#010x}).")


def _report(kind: int, report: Callable[[str], None]) -> None:
    texts = {
        _CONNECTED: "Connected to the Ultraleap service.",
        _CONNECTION_LOST: "Lost the connection to the Ultraleap service; waiting for it.",
        _DEVICE: "A tracking device is connected.",
        _DEVICE_LOST: "The tracking device was disconnected.",
    }
    if kind in texts:
        report(texts[kind])


def _sighting(functions: Any, event: int, clock: Callable[[], int]) -> Sighting:
    # The library owns the event and reuses it at the next poll, so everything is copied here.
    tracking = TrackingEvent.from_address(event)
    # Both clocks run on this machine, so the frame's age converts its time to this clock.
    age = max(0, functions.LeapGetNow() - tracking.timestamp) * 1000
    moment = clock() - age
    frames: dict[str, HandFrame] = {}
    for index in range(min(tracking.hand_count, 16)):
        with suppress(SkeletonError, ValueError):
            frame = hand_frame(tracking.hands[index], max(0, moment))
            frames.setdefault(frame.side, frame)
    return sighting(list(frames.values()), max(0, moment))


def hand_frame(hand: LeapHand, moment: int) -> HandFrame:
    """Convert a hand of the library.

    Args:
        hand: The library's structure.
        moment: When it was seen [ns].

    Raises:
        SkeletonError: Its joints do not form a hand.
    """
    if hand.type not in (0, 1):
        raise SkeletonError("bad side")
    side = SIDES[hand.type]
    positions = np.full((JOINT_COUNT, 3), np.nan)
    radii = np.full(JOINT_COUNT, np.nan)
    reference = reference_hand(side)
    for finger, digit in zip(FINGERS, hand.digits, strict=True):
        # Leap's thumb has a metacarpal of zero length; its next bone is OpenXR's metacarpal.
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
