# SPDX-License-Identifier: GPL-3.0-or-later
"""Live tracking in Blender: a timer fetches the frames that have arrived and poses armatures."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ..base.activity import ActivityKind, clay_activity
from ..base.app_handlers import add_handlers, redraw_views, remove_handlers
from ..core.session.hand_path import HandPath, Moment
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
STEADY_PACE = 0.9
"""A simulation this near to real time keeps up with hands, which are then shown at once."""

_logger = logging.getLogger(__name__)


class LiveTracking:
    """Makes the armatures of a scene follow tracked hands, until `stop`."""

    def __init__(
        self, scene: bpy.types.Scene, *, clock: Callable[[], int] = time.perf_counter_ns
    ) -> None:
        """Open the receiver and start the sender.

        Raises:
            TrackingError: There is no hand armature, one cannot follow a hand, the port is in use,
                or the sender cannot be started.
        """
        self._scene_name = scene.name
        self._clock = clock
        self._tracker = HandTracker()
        self._targets: dict[str, tuple[str, HandTarget]] = {}
        self._hands: dict[str, TrackedHand] = {}
        self._posed_states: dict[str, State] = {}
        self._paths: dict[str, HandPath] = {}
        """How hands move while the clay is simulated more slowly than they do."""
        self._recorder: Recorder | None = None
        self.problem = ""
        """The last error message, for the panel."""
        armatures = hand_armatures(scene)
        if not armatures:
            raise TrackingError("Choose an armature for the left hand, the right hand, or both.")
        for side, armature in armatures.items():
            self._target(side, armature, scene)
        self.receiver = Receiver(scene.tactile_clay_tracking.port, clock=clock)
        self.sender: SenderProcess | None = None
        """The sender's process; None if it was started outside Blender."""
        try:
            command = sender_command(scene)
            self.sender = SenderProcess(command) if command else None
        except TrackingError:
            self.receiver.close()
            raise

    @property
    def recorder(self) -> Recorder | None:
        """The recording being written; None if there is none."""
        return self._recorder

    def hand(self, side: str) -> TrackedHand | None:
        """The hand at the last step, in the tracker's space [m]; None if it was never seen."""
        return self._hands.get(side)

    def record(self, path: Path) -> None:
        """Start recording the frames that arrive.

        Raises:
            TrackingError: The file cannot be created.
        """
        self.stop_recording()
        self._recorder = Recorder(path)

    def stop_recording(self) -> Path | None:
        """Stop recording.

        Returns:
            Path of the recording; None if nothing was recorded.

        Raises:
            TrackingError: The recording could not be completed.
        """
        recorder, self._recorder = self._recorder, None
        return recorder.close() if recorder is not None else None

    def step(self) -> bool:
        """Process the frames that have arrived and pose the hands.

        Returns:
            False if the scene no longer exists.
        """
        scene = bpy.data.scenes.get(self._scene_name)
        if scene is None:
            return False
        for arrival in self.receiver.drain():
            self._tracker.take(arrival.frame, arrival.seen)
            self._record(arrival.frame, arrival.seen)
        now = self._clock()
        hands = {side: self._tracker.hand(side, now) for side in SIDES}
        self._hands = {side: hand for side, hand in hands.items() if hand is not None}
        # Bakes and renders need the pose of their own frame.
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
            if hand.state == "lost" and self._posed_states.get(side) == "lost":
                # Its pose does not change; posing it again would reevaluate the scene needlessly.
                continue
            matrices = placed(target, hand, scene.tactile_clay_tracking.origin, scene)
            matrices, tracked = self._paced(side, matrices, hand.contact > 0.0, now)
            write_pose(armature, matrices, hand.contact if tracked else 0.0)
            self._posed_states[side] = hand.state
        return True

    def _paced(
        self, side: str, matrices: dict[str, NDArray[np.float64]], tracked: bool, now: int
    ) -> tuple[dict[str, NDArray[np.float64]], bool]:
        """The pose at the pace of the simulation, which may be slower than the hand."""
        pace = clay_activity.pace
        path = self._paths.get(side)
        if pace > STEADY_PACE and (path is None or not path.lag):
            self._paths.pop(side, None)
            return matrices, tracked
        if path is None:
            path = self._paths[side] = HandPath(tuple(matrices))
        if path.names != tuple(matrices):
            # Another armature follows the hand now.
            path = self._paths[side] = HandPath(tuple(matrices))
        bones, tracked = path.advance(
            Moment(now * 1e-9, pace), np.stack(list(matrices.values())), tracked
        )
        return dict(zip(path.names, bones, strict=True)), tracked

    def stop(self) -> None:
        """Stop the sender, the receiver and the recording; a second call does nothing.

        Raises:
            TrackingError: The recording could not be completed.
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
        cached = self._targets.get(side)
        if cached is None or cached[0] != armature.name:
            cached = self._targets[side] = (armature.name, read_target(armature, side, scene))
        return cached[1]


def hand_armatures(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """The armature of each side: the chosen ones or, if there are none, hands in the scene."""
    properties = scene.tactile_clay_tracking
    chosen = {side: getattr(properties, side) for side in SIDES}
    found = {side: item for side, item in chosen.items() if item is not None}
    if not found:
        for item in scene.objects:
            if item.type == "ARMATURE" and is_hand(item):
                found.setdefault(side_of(item) or "right", item)
    return {side: item for side, item in found.items() if item.name in scene.objects}


def sender_command(scene: bpy.types.Scene) -> list[str]:
    """The command that starts the sender for a scene's source; empty if it is started elsewhere.

    Raises:
        TrackingError: The recording to be played does not exist.
    """
    properties = scene.tactile_clay_tracking
    if properties.source == "OTHER":
        return []
    words = [properties.source.lower(), "--port", str(properties.port), "--attached"]
    if properties.source == "RECORDING":
        path = Path(bpy.path.abspath(properties.recording))
        if not path.is_file():
            raise TrackingError(f"The recording {path} does not exist. Choose another one.")
        words += [str(path), "--loop"]
    if bpy.app.binary_path:
        # Blender contains the Python and the add-on that a sender needs.
        return [bpy.app.binary_path, "--background", "--command", "clay", "track", *words]
    # The bpy module has no executable, but this package is installed in the Python it runs in.
    package = __name__.partition(".clay_addon.")[0]
    entry = f"from {package}.clay_addon.command.line import run; run()"
    return [sys.executable, "-c", entry, "track", *words]


class CurrentTracking:
    """Starts and stops tracking; there is at most one session."""

    def __init__(self) -> None:
        self.session: LiveTracking | None = None
        """The running session; None if there is none."""

    def start(self, scene: bpy.types.Scene) -> LiveTracking:
        """Start tracking; a running session is stopped first.

        Raises:
            TrackingError: As for `LiveTracking`.
        """
        self.stop()
        self.session = LiveTracking(scene)
        _logger.info("Tracking started: %s", scene.tactile_clay_tracking.source)
        if not bpy.app.timers.is_registered(_tick):
            bpy.app.timers.register(_tick, first_interval=0.0)
        return self.session

    def stop(self) -> str:
        """Stop tracking.

        Returns:
            The error message if stopping failed; otherwise empty.
        """
        ended, self.session = self.session, None
        if bpy.app.timers.is_registered(_tick):
            bpy.app.timers.unregister(_tick)
        if ended is None:
            return ""
        try:
            ended.stop()
        except TrackingError as error:
            _logger.warning("Tracking stopped with an error: %s", error)
            return str(error)
        _logger.info("Tracking stopped")
        return ""


tracking = CurrentTracking()
"""The tracking session of this Blender."""


def _tick() -> float | None:
    if tracking.session is None:
        return None
    try:
        scene_exists = tracking.session.step()
    except BaseException:
        # After an error, release the port and stop the sender.
        tracking.stop()
        raise
    if not scene_exists:
        tracking.stop()
        return None
    redraw_views()
    return STEP_SECONDS


@persistent
def _on_load(*_: object) -> None:
    tracking.stop()


def register() -> None:
    """Add the handler that stops tracking when another file is opened."""
    add_handlers((("load_pre", _on_load),))


def unregister() -> None:
    """Stop tracking and remove the handler."""
    tracking.stop()
    remove_handlers((("load_pre", _on_load),))
