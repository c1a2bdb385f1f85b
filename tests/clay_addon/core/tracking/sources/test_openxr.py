# SPDX-License-Identifier: GPL-3.0-or-later
"""The OpenXR source, tested with a fake of pyopenxr that imitates a runtime."""

import ctypes
import enum
import sys
from itertools import islice
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.protocol.joints import ALL_JOINTS
from tactile_clay.clay_addon.core.tracking.protocol.packet import encode
from tactile_clay.clay_addon.core.tracking.sources.openxr import openxr
from tactile_clay.tests.clay_addon.core.tracking.hands import flat_hand

EXTENSIONS = [
    b"XR_EXT_hand_tracking",
    b"XR_MND_headless",
    b"XR_KHR_convert_timespec_time",
    b"XR_KHR_win32_convert_performance_counter_time",
]


class Vector(ctypes.Structure):
    """XrVector3f."""

    _fields_ = [(name, ctypes.c_float) for name in "xyz"]


class Quaternion(ctypes.Structure):
    """XrQuaternionf."""

    _fields_ = [(name, ctypes.c_float) for name in "xyzw"]


class Pose(ctypes.Structure):
    """XrPosef."""

    _fields_ = [("orientation", Quaternion), ("position", Vector)]


class Location(ctypes.Structure):
    """XrHandJointLocationEXT."""

    _fields_ = [("location_flags", ctypes.c_uint64), ("pose", Pose), ("radius", ctypes.c_float)]


class Locations(ctypes.Structure):
    """XrHandJointLocationsEXT."""

    _fields_ = [
        ("type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("is_active", ctypes.c_uint32),
        ("joint_count", ctypes.c_uint32),
        ("places", ctypes.POINTER(Location)),
    ]

    def __init__(self, joint_count: int, joint_locations: Any) -> None:
        super().__init__(
            joint_count=joint_count, places=ctypes.cast(joint_locations, ctypes.POINTER(Location))
        )

    @property
    def joint_locations(self) -> list[Location]:
        return [self.places[joint] for joint in range(self.joint_count)]


class LocateInfo(ctypes.Structure):
    """XrHandJointsLocateInfoEXT."""

    _fields_ = [("base_space", ctypes.c_uint64), ("time", ctypes.c_int64)]


class Changed(ctypes.Structure):
    """XrEventDataSessionStateChanged."""

    _fields_ = [("type", ctypes.c_int), ("state", ctypes.c_int)]


class State(enum.IntEnum):
    """XrSessionState."""

    READY = 2
    FOCUSED = 5
    STOPPING = 6
    LOSS_PENDING = 7
    EXITING = 8


class Runtime:
    """A runtime that becomes ready, shows a right hand, and ends."""

    locate_type: ClassVar[Any] = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_uint64, ctypes.POINTER(LocateInfo), ctypes.POINTER(Locations)
    )

    def __init__(self) -> None:
        self.extensions = list(EXTENSIONS)
        self.states: list[State | None] = [None, State.READY, State.FOCUSED]
        self.calls: list[str] = []
        self.flags = 0b1111
        self.result = 0
        self._locate = self.locate_type(self.locate)
        error = type("XrException", (Exception,), {})
        named = {
            name: type(name, (error,), {})
            for name in ("EventUnavailable", "ReferenceSpaceUnsupportedError")
        }
        self.error = error

        def logged(name: str, result: Any) -> Any:
            def call(*_: Any, **__: Any) -> Any:
                self.calls.append(name)
                return result

            return call

        def plain(**values: Any) -> Any:
            return SimpleNamespace(**values)

        self.module = SimpleNamespace(
            exception=SimpleNamespace(XrException=error, **named),
            EventUnavailable=named["EventUnavailable"],
            enumerate_instance_extension_properties=lambda: [
                SimpleNamespace(extension_name=name) for name in self.extensions
            ],
            InstanceCreateInfo=plain,
            SystemGetInfo=plain,
            SessionCreateInfo=plain,
            SessionBeginInfo=plain,
            HandTrackerCreateInfoEXT=plain,
            create_instance=logged("create_instance", 1),
            destroy_instance=logged("destroy_instance", None),
            get_system=logged("get_system", 2),
            create_session=logged("create_session", 3),
            begin_session=logged("begin_session", None),
            end_session=logged("end_session", None),
            create_hand_tracker_ext=lambda _, info: info.hand,
            create_reference_space=self.space,
            ReferenceSpaceCreateInfo=plain,
            ReferenceSpaceType=SimpleNamespace(STAGE=3, LOCAL=2),
            FormFactor=SimpleNamespace(HEAD_MOUNTED_DISPLAY=1),
            ViewConfigurationType=SimpleNamespace(PRIMARY_STEREO=2),
            HandEXT=SimpleNamespace(LEFT=1, RIGHT=2),
            HandJointSetEXT=SimpleNamespace(DEFAULT=0),
            StructureType=SimpleNamespace(
                EVENT_DATA_SESSION_STATE_CHANGED=SimpleNamespace(value=18)
            ),
            SessionState=State,
            EventDataSessionStateChanged=Changed,
            poll_event=self.poll,
            get_instance_proc_addr=lambda _, name: self._locate,
            PFN_xrLocateHandJointsEXT=self.locate_type,
            HandJointLocationEXT=Location,
            HandJointLocationsEXT=Locations,
            HandJointsLocateInfoEXT=LocateInfo,
            check_result=self.check,
            timespec=SimpleNamespace,
            convert_timespec_time_to_time_khr=lambda _, moment: moment.tv_sec * 10**9,
        )

    def space(self, _: Any, info: Any) -> int:
        if info.reference_space_type == 3:
            raise self.module.exception.ReferenceSpaceUnsupportedError
        return 44

    def poll(self, _: Any) -> Changed:
        state = self.states.pop(0) if self.states else None
        if state is None:
            raise self.module.EventUnavailable
        return Changed(18, state)

    def check(self, code: int) -> Any:
        error = self.error("SESSION_LOST")
        error.is_exception = lambda: code < 0
        return error

    def locate(self, tracker: int, info: Any, locations: Any) -> int:
        assert info.contents.base_space == 44
        assert locations.contents.joint_count == 26
        found = locations.contents
        found.is_active = tracker == 2
        for place, row in zip(found.joint_locations, flat_hand("right"), strict=True):
            place.location_flags = self.flags
            place.pose.position = Vector(*row[:3])
            place.pose.orientation = Quaternion(*row[3:7])
            place.radius = row[7]
        return self.result


@pytest.fixture
def runtime() -> Runtime:
    """A new runtime."""
    return Runtime()


def test_hands_are_read_from_the_runtime(runtime: Runtime) -> None:
    """Begin the session when it is ready, and read the visible hand."""
    stream = openxr(runtime.module, clock=lambda: 123, sleep=lambda _: None)
    waiting, seen = islice(stream, 2)
    stream.close()
    assert waiting.frames == []
    (frame,) = seen.frames
    assert (frame.side, frame.source, frame.source_time) == ("right", "openxr", 123)
    assert np.allclose(frame.joints, flat_hand("right"))
    assert (frame.valid, frame.tracked, frame.confidence) == (ALL_JOINTS, ALL_JOINTS, 1.0)
    assert list(seen.absent) == ["left"]
    encode(frame)
    assert runtime.calls[-2:] == ["begin_session", "destroy_instance"]


def test_inferred_and_invalid_joints_are_distinguished(runtime: Runtime) -> None:
    """Distinguish joints that are tracked, inferred and invalid."""
    runtime.flags = 0b0011
    stream = openxr(runtime.module, sleep=lambda _: None)
    _, seen = islice(stream, 2)
    assert (seen.frames[0].valid, seen.frames[0].tracked) == (ALL_JOINTS, 0)
    assert seen.frames[0].confidence < 1.0
    runtime.flags = 0b0001
    assert not next(stream).frames[0].usable
    stream.close()


@pytest.mark.parametrize("state", [State.EXITING, State.LOSS_PENDING])
def test_end_of_the_session_is_reported(runtime: Runtime, state: State) -> None:
    """Raise a message, and destroy the instance."""
    runtime.states += [None, State.STOPPING, state]
    with pytest.raises(TrackingError, match="ended the session"):
        list(openxr(runtime.module, sleep=lambda _: None))
    assert runtime.calls[-2:] == ["end_session", "destroy_instance"]


def test_missing_extension_is_named(runtime: Runtime) -> None:
    """Name the extension that the runtime lacks."""
    runtime.extensions.remove(b"XR_MND_headless")
    with pytest.raises(TrackingError, match="lacks XR_MND_headless"):
        next(openxr(runtime.module))


def test_failing_runtime_is_explained(runtime: Runtime) -> None:
    """Report the runtime's errors, before and during the session."""
    stream = openxr(runtime.module, sleep=lambda _: None)
    next(stream)
    runtime.result = -17
    with pytest.raises(TrackingError, match="SESSION_LOST"):
        next(stream)

    def fail() -> None:
        raise runtime.error("no runtime")

    runtime.module.enumerate_instance_extension_properties = fail
    with pytest.raises(TrackingError, match="No OpenXR runtime can be reached"):
        next(openxr(runtime.module))


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what to install."""
    monkeypatch.setitem(sys.modules, "xr", None)
    with pytest.raises(TrackingError, match=r"pip install 'tactile-clay\[openxr\]'"):
        next(openxr())
