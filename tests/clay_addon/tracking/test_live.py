# SPDX-License-Identifier: GPL-3.0-or-later
"""Live tracking in Blender, with datagrams over loopback and a timer called by the tests."""

import socket
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

import tactile_clay
from tactile_clay.clay_addon.base.activity import ActivityKind, clay_activity
from tactile_clay.clay_addon.core.tracking.hand.retarget import Z_UP
from tactile_clay.clay_addon.core.tracking.protocol.packet import encode
from tactile_clay.clay_addon.core.tracking.recording.recording import Recorder, read_recording
from tactile_clay.clay_addon.tracking import live, panel
from tactile_clay.clay_addon.tracking.armature import CONTACT_PROPERTY
from tactile_clay.tests.clay_addon.core.tracking.hands import Clock, frame_at
from tactile_clay.tests.clay_addon.tracking.blender_rigs import add_hand, head_positions


class Stage:
    """A scene with armatures for two tracked hands, and a sender."""

    def __init__(self, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = clock
        self.hands = {side: add_hand(side, name=f"Hand {side}") for side in ("left", "right")}
        properties = bpy.context.scene.tactile_clay_tracking
        properties.left, properties.right = self.hands["left"], self.hands["right"]
        with socket.socket(type=socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            properties.port = free.getsockname()[1]
        self.wire = socket.socket(type=socket.SOCK_DGRAM)
        self.wire.connect(("127.0.0.1", properties.port))
        self.number = 0
        self.session: Any = None
        monkeypatch.setattr(live.LiveTracking.__init__, "__kwdefaults__", {"clock": clock})

    def start(self) -> None:
        """Press Start Tracking."""
        assert bpy.ops.clay.tracking_start() == {"FINISHED"}
        self.session = live.tracking.session

    def show(self, milliseconds: float, *, at: Any = (0.1, 0.3, -0.2)) -> None:
        """Send both hands for some time, and run the timer at each frame."""
        for _ in range(round(milliseconds / 10)):
            self.number += 1
            now = self.clock.turn(10)
            tremor = 1e-5 * (self.number % 2)
            for side, sign in (("left", -1.0), ("right", 1.0)):
                place = np.array(at) * [sign, 1.0, 1.0] + [tremor, 0.0, 0.0]
                self.wire.send(encode(frame_at(now, self.number, side, place)))
            live._tick()


@pytest.fixture
def stage(studio: Any, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    """A scene ready for tracking."""
    stage = Stage(clock, monkeypatch)
    yield stage
    live.tracking.stop()
    stage.wire.close()


def test_both_hands_follow(stage: Stage) -> None:
    """Pose both armatures like the hands, with their contact."""
    stage.start()
    stage.show(300)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        wrist = head_positions(stage.hands[side])["wrist"]
        assert np.allclose(wrist, Z_UP @ [0.1 * sign, 0.3, -0.2], atol=1e-3)
        assert stage.hands[side][CONTACT_PROPERTY] == pytest.approx(1.0)


def test_lost_hand_keeps_its_pose_and_touches_nothing(stage: Stage) -> None:
    """Keep the last pose of a lost hand, without contact."""
    stage.start()
    stage.show(300)
    before = head_positions(stage.hands["left"])
    stage.clock.turn(500)
    live._tick()
    after = head_positions(stage.hands["left"])
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert stage.hands["left"][CONTACT_PROPERTY] == 0.0


@pytest.mark.parametrize("pace", [0.1, 0.25, 0.5])
def test_a_hand_does_not_leap_through_slow_clay(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, pace: float
) -> None:
    """In simulated time it moves no faster than it did, and comes to the same place."""
    stage.start()
    stage.show(300)
    monkeypatch.setattr(clay_activity, "pace", pace)
    stage.show(20)
    hand = stage.hands["right"]
    before = head_positions(hand)["wrist"]
    fastest = 0.0
    for number in range(40):
        # One meter in a second.
        stage.show(10, at=(0.1 + 0.01 * number, 0.3, -0.2))
        now = head_positions(hand)["wrist"]
        fastest = max(fastest, float(np.linalg.norm(now - before)) / 0.01)
        before = now
    # The tracker's filter may overshoot a little.
    assert fastest < 1.4 * pace
    stage.show(6000, at=(0.49, 0.3, -0.2))
    assert np.allclose(head_positions(hand)["wrist"], Z_UP @ [0.49, 0.3, -0.2], atol=2e-3)
    monkeypatch.setattr(clay_activity, "pace", 1.0)
    stage.show(12_000, at=(0.49, 0.3, -0.2))
    assert not stage.session._paths


def test_pose_is_left_alone_during_a_bake(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Move no hand during a bake, and continue after it."""
    stage.start()
    stage.show(300)
    before = head_positions(stage.hands["left"])
    monkeypatch.setattr(clay_activity, "kind", ActivityKind.BAKE)
    stage.show(100, at=(0.15, 0.3, -0.2))
    after = head_positions(stage.hands["left"])
    assert all(np.array_equal(before[name], after[name]) for name in before)
    stage.clock.turn(500)
    live._tick()
    assert stage.hands["left"][CONTACT_PROPERTY] > 0.0
    monkeypatch.undo()
    live._tick()
    # The hand was lost meanwhile, so it loses its contact now.
    assert stage.hands["left"][CONTACT_PROPERTY] == 0.0
    assert not np.array_equal(before["wrist"], head_positions(stage.hands["left"])["wrist"])


def test_what_arrives_is_recorded(stage: Stage, tmp_path: Path) -> None:
    """Record every frame that arrives while recording, in a new file each time."""
    folder = tmp_path / "recordings"
    bpy.context.scene.tactile_clay_tracking.recording_folder = str(folder)
    stage.start()
    stage.show(100)
    for number in (1, 2):
        assert bpy.ops.clay.tracking_record() == {"FINISHED"}
        stage.show(100)
        assert bpy.ops.clay.tracking_record() == {"FINISHED"}
        assert len(read_recording(folder / f"hands-00{number}.jsonl")) == 20
    assert bpy.ops.clay.tracking_record() == {"FINISHED"}
    stage.show(50)
    # Stopping also completes the recording.
    assert bpy.ops.clay.tracking_stop() == {"FINISHED"}
    assert len(read_recording(folder / "hands-003.jsonl")) == 10


def test_animated_hand_follows_too(stage: Stage) -> None:
    """Follow the tracker with an armature that has an action, until the frame changes."""
    item = stage.hands["right"]
    item.pose.bones["wrist"].keyframe_insert("location", frame=1)
    item[CONTACT_PROPERTY] = 0.0
    item.keyframe_insert(f'["{CONTACT_PROPERTY}"]', frame=1)
    stage.start()
    stage.show(300)
    assert np.allclose(head_positions(item)["wrist"], Z_UP @ [0.1, 0.3, -0.2], atol=1e-3)
    assert item[CONTACT_PROPERTY] == pytest.approx(1.0)


def test_recording_needs_a_folder(stage: Stage) -> None:
    """Explain that an unsaved .blend file has no folder for recordings."""
    stage.start()
    with pytest.raises(RuntimeError, match=r"Save the \.blend file first"):
        bpy.ops.clay.tracking_record()


def test_start_without_a_hand_is_refused(studio: Any) -> None:
    """Say what to choose."""
    assert "Choose an armature" in studio.refused(bpy.ops.clay.tracking_start)
    assert live.tracking.session is None


def test_port_in_use_is_explained(stage: Stage) -> None:
    """Say that another Blender may be tracking."""
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", bpy.context.scene.tactile_clay_tracking.port))
        with pytest.raises(RuntimeError, match="another Blender that is tracking"):
            bpy.ops.clay.tracking_start()


def test_hands_of_the_scene_are_found_by_name(studio: Any) -> None:
    """Use the scene's hand armatures if none is chosen."""
    left, right = add_hand("left", name="Hand.L"), add_hand("right", name="Hand.R")
    assert live.hand_armatures(studio.scene) == {"left": left, "right": right}


def test_starting_twice_and_stopping_twice_is_allowed(stage: Stage) -> None:
    """Restart on the same port, and stop once."""
    stage.start()
    stage.start()
    assert bpy.app.timers.is_registered(live._tick)
    assert live.tracking.stop() == ""
    assert live.tracking.stop() == ""
    assert not bpy.app.timers.is_registered(live._tick)
    assert live._tick() is None


@pytest.mark.parametrize("how", ["load", "unregister", "scene"])
def test_tracking_ends_with_file_addon_or_scene(stage: Stage, how: str) -> None:
    """Release the port and the timer when the file is closed or the add-on or scene is removed."""
    stage.start()
    stage.show(50)
    if how == "load":
        bpy.ops.wm.read_factory_settings(use_empty=True)
        tactile_clay.register()
    elif how == "unregister":
        tactile_clay.unregister()
    else:
        bpy.context.scene.name = "Another"
        live._tick()
    assert live.tracking.session is None
    assert not bpy.app.timers.is_registered(live._tick)
    assert stage.session.receiver.drain() == []
    tactile_clay.register()


def test_deleted_armature_is_no_error(stage: Stage) -> None:
    """Continue with one hand when the other's armature is deleted."""
    stage.start()
    stage.show(100)
    bpy.data.objects.remove(stage.hands["left"])
    stage.show(100)
    assert live.tracking.session is not None
    assert stage.hands["right"][CONTACT_PROPERTY] > 0.5


def test_error_in_the_timer_stops_tracking(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop tracking after an unexpected error, and pass the error on."""
    stage.start()
    monkeypatch.setattr(stage.session.receiver, "drain", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        live._tick()
    assert live.tracking.session is None


def wait_until(condition: Any) -> None:
    """Run the timer until a condition holds."""
    for _ in range(3000):
        live._tick()
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError("the condition never became true")


def test_sender_is_started_and_stopped_with_tracking(stage: Stage, tmp_path: Path) -> None:
    """Play a recording from a separate process, which exits when tracking stops."""
    recorder = Recorder(tmp_path / "take.jsonl")
    for number in range(20):
        at = (0.1 + 1e-4 * number, 0.2, 0.0)
        recorder.take(frame_at(number, number, at=at), number * 10_000_000)
    recorder.close()
    properties = bpy.context.scene.tactile_clay_tracking
    properties.source, properties.recording = "RECORDING", str(tmp_path / "take.jsonl")
    stage.start()
    wait_until(lambda: stage.session.receiver.accepted > 40)
    assert stage.session.sender.runs
    live.tracking.stop()
    assert not stage.session.sender.runs
    assert stage.session.sender.problem == ""


def test_panel_shows_why_a_sender_failed(stage: Stage, tmp_path: Path) -> None:
    """Show the error message of a sender that exited."""
    (tmp_path / "bad.jsonl").write_text("no recording")
    properties = bpy.context.scene.tactile_clay_tracking
    properties.source, properties.recording = "RECORDING", str(tmp_path / "bad.jsonl")
    stage.start()
    wait_until(lambda: not stage.session.sender.runs)
    assert "is not valid JSON" in drawn()


def test_missing_recording_is_refused(stage: Stage) -> None:
    """Start nothing, and release the port."""
    bpy.context.scene.tactile_clay_tracking.source = "RECORDING"
    with pytest.raises(RuntimeError, match=r"does not exist\. Choose another one"):
        bpy.ops.clay.tracking_start()
    bpy.context.scene.tactile_clay_tracking.source = "OTHER"
    stage.start()


class Layout:
    """Collects the texts that a panel draws."""

    def __init__(self, texts: list[str]) -> None:
        self.texts = texts

    def __getattr__(self, name: str) -> Any:
        if name in ("row", "column", "box"):
            return lambda **_: Layout(self.texts)
        return lambda *_, text="", **__: self.texts.append(text)


def drawn() -> str:
    """The texts of the panel."""
    layout = Layout([])
    cls: Any = panel.CLAY_PT_tracking
    cls.draw(SimpleNamespace(layout=layout), bpy.context)
    return " ".join(layout.texts)


def test_panel_shows_the_status_of_tracking(stage: Stage, tmp_path: Path) -> None:
    """Show what to do, then source, states, rates, rejected datagrams and the recording."""
    bpy.context.scene.tactile_clay_tracking.recording_folder = str(tmp_path)
    assert "No hands have arrived" not in drawn()
    stage.start()
    assert "No hands have arrived" in drawn()
    stage.show(300)
    text = drawn()
    assert "Source: leap" in text
    assert "Left: live, 30 frames/s" in text
    stage.wire.send(b"what?")
    bpy.ops.clay.tracking_record()
    stage.show(50)
    text = drawn()
    assert "Rejected datagrams: 1 (1 × wrong length)" in text
    assert "Stop Recording (10 frames)" in text
    for state in ("held", "lost"):
        stage.clock.turn(150)
        # Drawing shows the state of the timer's last step.
        assert f"Right: {state}" not in drawn()
        live._tick()
        assert f"Right: {state}" in drawn()
