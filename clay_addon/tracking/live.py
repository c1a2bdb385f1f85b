# SPDX-License-Identifier: GPL-3.0-or-later
"""Live tracking in Blender: a timer that fetches what has arrived and poses the armatures."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..base.activity import ActivityKind, clay_activity
from ..base.app_handlers import add_handlers, redraw_views, remove_handlers
from ..core.tracking import TrackingError
from ..core.tracking.hand.hand_tracker import HandTracker
from ..core.tracking.hand.presence import State, TrackedHand
from ..core.tracking.hand.retarget import HandTarget
from ..core.tracking.protocol.joints import SIDES
from ..core.tracking.protocol.packet import HandFrame
from ..core.tracking.protocol.receiver import Receiver
from ..core.tracking.recording.recording import Recorder
from ..core.tracking.sources.sender_process import SenderProcess
from .armature import is_hand, placed, read_target, side_of, write_pose

STEP_SECONDS = 1.0 / 60.0

_logger = logging.getLogger(__name__)


class LiveTracking:
    """Follows tracked hands with the armatures of a scene, until `stop`."""

    def __init__(
        self, scene: bpy.types.Scene, *, clock: Callable[[], int] = time.perf_counter_ns
    ) -> None:
        """Open the receiver.

        Raises:
            TrackingError: No armature is chosen, one cannot follow a hand, or the port is in use.
        """
        self._scene_name = scene.name
        self._clock = clock
        self._tracker = HandTracker()
        self._targets: dict[str, tuple[str, HandTarget]] = {}
        self._hands: dict[str, TrackedHand] = {}
        self._written: dict[str, State] = {}
        self._recorder: Recorder | None = None
        self.problem = ""
        """What went wrong last, for the panel."""
        armatures = hand_armatures(scene)
        if not armatures:
            raise TrackingError("Choose the armature of a hand: left, right or both.")
        for side, armature in armatures.items():
            self._target(side, armature, scene)
        self.receiver = Receiver(scene.tactile_clay_tracking.port, clock=clock)
        self.sender: SenderProcess | None = None
        """The sender that was started beside; None where it was started elsewhere."""
        try:
            command = sender_command(scene)
            self.sender = SenderProcess(command) if command else None
        except TrackingError:
            self.receiver.close()
            raise

    @property
    def recorder(self) -> Recorder | None:
        """The recording that is being written; None while there is none."""
        return self._recorder

    def hand(self, side: str) -> TrackedHand | None:
        """A hand as of the last step, in the tracker's space [m]; None before one was seen."""
        return self._hands.get(side)

    def record(self, path: Path) -> None:
        """Begin to record what arrives.

        Raises:
            TrackingError: It cannot be written there.
        """
        self.stop_recording()
        self._recorder = Recorder(path)

    def stop_recording(self) -> Path | None:
        """End the recording; its path, or None where nothing was recorded.

        Raises:
            TrackingError: It could not be written to its end.
        """
        recorder, self._recorder = self._recorder, None
        return recorder.close() if recorder is not None else None

    def step(self) -> bool:
        """Fetch what has arrived and pose the hands; False where the scene is gone."""
        scene = bpy.data.scenes.get(self._scene_name)
        if scene is None:
            return False
        for arrival in self.receiver.drain():
            self._tracker.take(arrival.frame, arrival.seen)
            self._record(arrival.frame, arrival.seen)
        now = self._clock()
        hands = {side: self._tracker.hand(side, now) for side in SIDES}
        self._hands = {side: hand for side, hand in hands.items() if hand is not None}
        # A bake and a render read the pose of their own frame.
        if clay_activity.kind is ActivityKind.BAKE or bpy.app.is_job_running("RENDER"):
            return True
        for side, armature in hand_armatures(scene).items():
            hand = self._hands.get(side)
            if hand is None:
                continue
            try:
                target = self._target(side, armature, scene)
            except TrackingError as error:
                self.problem = str(error)
                continue
            if hand.state == "lost" and self._written.get(side) == "lost":
                # It stays where it is; posing it again would evaluate the scene for nothing.
                continue
            matrices = placed(target, hand, scene.tactile_clay_tracking.origin, scene)
            write_pose(armature, matrices, hand.contact)
            self._written[side] = hand.state
        return True

    def stop(self) -> None:
        """Close the receiver and the recording; a second call does nothing.

        Raises:
            TrackingError: The recording could not be written to its end.
        """
        if self.sender is not None:
            self.sender.stop()
        self.receiver.close()
        self.stop_recording()

    def _record(self, frame: HandFrame, seen: int) -> None:
        if self._recorder is None:
            return
        try:
            self._recorder.take(frame, seen)
        except TrackingError as error:
            self.problem = str(error)
            self._recorder = None

    def _target(self, side: str, armature: bpy.types.Object, scene: bpy.types.Scene) -> HandTarget:
        known = self._targets.get(side)
        if known is None or known[0] != armature.name:
            known = self._targets[side] = (armature.name, read_target(armature, side, scene))
        return known[1]


def hand_armatures(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """The armature of each hand: those chosen, else those in the scene that are named as hands."""
    properties = scene.tactile_clay_tracking
    chosen = {side: getattr(properties, side) for side in SIDES}
    found = {side: item for side, item in chosen.items() if item is not None}
    if not found:
        for item in scene.objects:
            if item.type == "ARMATURE" and is_hand(item):
                found.setdefault(side_of(item) or "right", item)
    return {side: item for side, item in found.items() if item.name in scene.objects}


def sender_command(scene: bpy.types.Scene) -> list[str]:
    """The command that starts the sender of a scene's source; empty where it has none.

    Raises:
        TrackingError: The recording that it is to play is not there.
    """
    properties = scene.tactile_clay_tracking
    if properties.source == "OTHER":
        return []
    words = [properties.source.lower(), "--port", str(properties.port), "--attached"]
    if properties.source == "RECORDING":
        path = Path(bpy.path.abspath(properties.recording))
        if not path.is_file():
            raise TrackingError(f"There is no recording {path}. Choose one under Recording.")
        words += [str(path), "--loop"]
    if bpy.app.binary_path:
        # Blender itself has the Python and the add-on that a sender needs.
        return [bpy.app.binary_path, "--background", "--command", "clay", "track", *words]
    # The bpy module has no program of its own, but a Python with this package installed.
    package = __name__.partition(".clay_addon.")[0]
    entry = f"from {package}.clay_addon.command.line import run; run()"
    return [sys.executable, "-c", entry, "track", *words]


class CurrentTracking:
    """Starts and ends tracking; there is never more than one."""

    def __init__(self) -> None:
        self.session: LiveTracking | None = None
        """What tracks now; None while nothing does."""

    def start(self, scene: bpy.types.Scene) -> LiveTracking:
        """Start to track; tracking that runs is stopped first.

        Raises:
            TrackingError: As for `LiveTracking`.
        """
        self.stop()
        self.session = LiveTracking(scene)
        _logger.info("Tracking starts: %s", scene.tactile_clay_tracking.source)
        if not bpy.app.timers.is_registered(_tick):
            bpy.app.timers.register(_tick, first_interval=0.0)
        return self.session

    def stop(self) -> str:
        """Stop to track.

        Returns:
            What went wrong while doing so; empty where nothing did, or nothing was tracking.
        """
        ended, self.session = self.session, None
        if bpy.app.timers.is_registered(_tick):
            bpy.app.timers.unregister(_tick)
        if ended is None:
            return ""
        try:
            ended.stop()
        except TrackingError as error:
            _logger.warning("Tracking ended with an error: %s", error)
            return str(error)
        _logger.info("Tracking stops")
        return ""


tracking = CurrentTracking()
"""The tracking of this Blender."""


def _tick() -> float | None:
    if tracking.session is None:
        return None
    try:
        goes_on = tracking.session.step()
    except BaseException:
        # Nothing may go on half, with the port held.
        tracking.stop()
        raise
    if not goes_on:
        tracking.stop()
        return None
    redraw_views()
    return STEP_SECONDS


@persistent
def _on_load(*_: object) -> None:
    tracking.stop()


def register() -> None:
    """Add the handler that ends tracking when another file is opened."""
    add_handlers((("load_pre", _on_load),))


def unregister() -> None:
    """End tracking, and take the handler away."""
    tracking.stop()
    remove_handlers((("load_pre", _on_load),))
