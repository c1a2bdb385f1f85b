# SPDX-License-Identifier: GPL-3.0-or-later
"""An OpenXR runtime as a source of hands: XR_EXT_hand_tracking, through pyopenxr.

The session is headless (XR_MND_headless), so that nothing has to be rendered. Runtimes without that
extension, such as SteamVR, are not supported.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from .. import TrackingError
from ..protocol.joints import JOINT_COUNT, SIDES
from ..protocol.packet import HandFrame, joint_array
from .sender import Sighting, sighting

_STEP_SECONDS = 0.01
_IDLE_SECONDS = 0.1
_POSE_VALID, _POSE_TRACKED = 0b0011, 0b1100
"""Orientation and position, in XrSpaceLocationFlags."""


def openxr(
    xr: Any = None,
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> Generator[Sighting, None, None]:
    """Yield the hands of the machine's OpenXR runtime until the session ends.

    Args:
        xr: The pyopenxr module; imported by default.
        clock: The time [ns].
        sleep: Waits for a number of seconds.

    Raises:
        TrackingError: pyopenxr or a runtime is missing, the runtime lacks a required extension or
            fails, or the session has ended.
    """
    xr = _library() if xr is None else xr
    try:
        with _Session(xr) as session:
            while session.alive():
                if not session.running:
                    yield sighting([])
                    sleep(_IDLE_SECONDS)
                    continue
                moment = clock()
                frames = [session.hand(side, moment) for side in SIDES]
                yield sighting([frame for frame in frames if frame is not None], moment)
                sleep(_STEP_SECONDS)
    except xr.exception.XrException as error:
        raise TrackingError(f"The OpenXR runtime failed ({_description(error)}).") from error
    raise TrackingError("The OpenXR runtime ended the session.")


def _library() -> Any:
    try:
        import xr
    except ImportError as error:
        raise TrackingError(
            "pyopenxr is missing. Install it into this Python: pip install 'tactile-clay[openxr]', "
            "or pip install pyopenxr."
        ) from error
    return xr


def _description(error: Exception) -> str:
    return str(error) or type(error).__name__


class _Session:
    """A headless session with a tracker for each hand."""

    def __init__(self, xr: Any) -> None:
        self._xr = xr
        self.running = False
        self._over = False
        self._windows = sys.platform == "win32"
        clock_extension = (
            "XR_KHR_win32_convert_performance_counter_time"
            if self._windows
            else "XR_KHR_convert_timespec_time"
        )
        needed = ["XR_EXT_hand_tracking", "XR_MND_headless", clock_extension]
        try:
            offered = {
                bytes(item.extension_name).split(b"\0")[0].decode()
                for item in xr.enumerate_instance_extension_properties()
            }
        except xr.exception.XrException as error:
            raise TrackingError(
                f"No OpenXR runtime can be reached ({_description(error)}). Start one, and make it "
                "the machine's active runtime."
            ) from error
        missing = [name for name in needed if name not in offered]
        if missing:
            raise TrackingError(f"The OpenXR runtime lacks {', '.join(missing)}.")
        self._instance = xr.create_instance(xr.InstanceCreateInfo(enabled_extension_names=needed))
        try:
            self._system = xr.get_system(
                self._instance, xr.SystemGetInfo(form_factor=xr.FormFactor.HEAD_MOUNTED_DISPLAY)
            )
            self._session = xr.create_session(
                self._instance, xr.SessionCreateInfo(system_id=self._system, next=None)
            )
            self._space = self._reference_space()
            self._trackers = {
                side: xr.create_hand_tracker_ext(
                    self._session,
                    xr.HandTrackerCreateInfoEXT(
                        hand=xr.HandEXT.LEFT if side == "left" else xr.HandEXT.RIGHT,
                        hand_joint_set=xr.HandJointSetEXT.DEFAULT,
                    ),
                )
                for side in SIDES
            }
        except BaseException:
            xr.destroy_instance(self._instance)
            raise
        # pyopenxr's own wrapper does not allocate memory for the joints.
        self._locate = ctypes.cast(
            xr.get_instance_proc_addr(self._instance, "xrLocateHandJointsEXT"),
            xr.PFN_xrLocateHandJointsEXT,
        )

    def __enter__(self) -> _Session:
        return self

    def __exit__(self, *_: object) -> None:
        # This also destroys everything created in the instance.
        self._xr.destroy_instance(self._instance)

    def alive(self) -> bool:
        """Process the runtime's events; False once the session has ended."""
        xr = self._xr
        while not self._over:
            try:
                event = xr.poll_event(self._instance)
            except xr.EventUnavailable:
                break
            if event.type != xr.StructureType.EVENT_DATA_SESSION_STATE_CHANGED.value:
                continue
            changed = ctypes.cast(
                ctypes.byref(event), ctypes.POINTER(xr.EventDataSessionStateChanged)
            ).contents
            state = xr.SessionState(changed.state)
            if state == xr.SessionState.READY:
                xr.begin_session(
                    self._session,
                    xr.SessionBeginInfo(
                        primary_view_configuration_type=xr.ViewConfigurationType.PRIMARY_STEREO
                    ),
                )
                self.running = True
            elif state == xr.SessionState.STOPPING:
                self.running = False
                xr.end_session(self._session)
            elif state in (xr.SessionState.EXITING, xr.SessionState.LOSS_PENDING):
                self._over = True
        return not self._over

    def hand(self, side: str, moment: int) -> HandFrame | None:
        """Locate a hand now; None if it is not in view."""
        xr = self._xr
        storage = (xr.HandJointLocationEXT * JOINT_COUNT)()
        locations = xr.HandJointLocationsEXT(joint_count=JOINT_COUNT, joint_locations=storage)
        result = xr.check_result(
            self._locate(
                self._trackers[side],
                xr.HandJointsLocateInfoEXT(base_space=self._space, time=self._now()),
                ctypes.byref(locations),
            )
        )
        if result.is_exception():
            raise result
        if not locations.is_active:
            return None
        valid = tracked = 0
        rows = np.zeros((JOINT_COUNT, 8))
        rows[:, 6] = 1.0
        for joint, location in enumerate(locations.joint_locations):
            flags = int(location.location_flags)
            if flags & _POSE_VALID != _POSE_VALID:
                continue
            valid |= 1 << joint
            if flags & _POSE_TRACKED == _POSE_TRACKED:
                tracked |= 1 << joint
            p, q = location.pose.position, location.pose.orientation
            rows[joint] = p.x, p.y, p.z, q.x, q.y, q.z, q.w, location.radius
        return HandFrame(
            side=side,
            source_time=moment,
            source="openxr",
            # OpenXR has no confidence; without any tracked joint the whole hand is inferred.
            confidence=1.0 if tracked else 0.5,
            valid=valid,
            tracked=tracked,
            joints=joint_array(rows[:, :3], rows[:, 3:7], rows[:, 7]),
        )

    def _reference_space(self) -> Any:
        xr = self._xr
        for kind in (xr.ReferenceSpaceType.STAGE, xr.ReferenceSpaceType.LOCAL):
            try:
                return xr.create_reference_space(
                    self._session, xr.ReferenceSpaceCreateInfo(reference_space_type=kind)
                )
            except xr.exception.ReferenceSpaceUnsupportedError:
                continue
        raise TrackingError("The OpenXR runtime supports neither the STAGE nor the LOCAL space.")

    def _now(self) -> Any:
        """The current time on the runtime's clock."""
        xr = self._xr
        if self._windows:
            counter = ctypes.c_int64()
            ctypes.windll.kernel32.QueryPerformanceCounter(ctypes.byref(counter))  # type: ignore[attr-defined]
            return xr.convert_win32_performance_counter_to_time_khr(self._instance, counter)
        seconds, rest = divmod(time.clock_gettime_ns(time.CLOCK_MONOTONIC), 1_000_000_000)
        moment = xr.timespec()
        moment.tv_sec, moment.tv_nsec = seconds, rest
        return xr.convert_timespec_time_to_time_khr(self._instance, moment)
