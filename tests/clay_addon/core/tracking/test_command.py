# SPDX-License-Identifier: GPL-3.0-or-later
"""``tactile-clay track``: usage, and playing files to the receiver."""

import json
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tactile_clay.clay_addon.command.line import main
from tactile_clay.clay_addon.core.tracking.protocol.receiver import Receiver
from tactile_clay.clay_addon.core.tracking.recording.recording import Recorder, read_recording
from tactile_clay.tests.clay_addon.core.tracking.formats.test_leap import leap_hand, message
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording of fifty frames."""
    recorder = Recorder(tmp_path / "hands.jsonl")
    for number in range(50):
        frame = frame_at(number, number, at=(1e-4 * number, 0.2, 0.0))
        recorder.take(frame, number * MILLISECOND)
    recorder.close()
    return tmp_path / "hands.jsonl"


def test_recording_is_sent_to_the_receiver(
    recording: Path, receiver: Receiver, capfd: pytest.CaptureFixture[str]
) -> None:
    """Play a complete recording to a receiver, and print how much was sent."""
    port = str(receiver.address[1])
    assert main(["track", "recording", str(recording), "--port", port, "--speed", "0"]) == 0
    frames = [arrival.frame for arrival in receiver.drain()]
    assert [frame.side for frame in frames if frame.active] == ["right"] * 50
    assert capfd.readouterr().out == "52 datagrams sent.\n"


def test_leap_file_is_converted_to_a_recording(
    tmp_path: Path, receiver: Receiver, capfd: pytest.CaptureFixture[str]
) -> None:
    """Record a LeapJS file while it is played."""
    frames = [message(leap_hand(), timestamp=1000 + 1000 * number) for number in range(5)]
    (tmp_path / "leap.json").write_text(json.dumps({"frames": frames}))
    target = tmp_path / "hands.jsonl"
    options = ["--port", str(receiver.address[1]), "--record", str(target)]
    assert main(["track", "leap", str(tmp_path / "leap.json"), *options]) == 0
    assert str(target) in capfd.readouterr().out
    entries = read_recording(target)
    times = [entry.time for entry in entries if entry.frame.active]
    assert times == [number * MILLISECOND for number in range(5)]


def test_loop_ends_after_its_duration(recording: Path, receiver: Receiver) -> None:
    """Stop playing in a loop after the duration."""
    port = str(receiver.address[1])
    options = ["--port", port, "--loop", "--duration", "0.2"]
    thread = threading.Thread(target=main, args=(["track", "recording", str(recording), *options],))
    thread.start()
    thread.join(timeout=30)
    assert not thread.is_alive()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([], 2, "required: SOURCE"),
        (["kinect"], 2, "invalid choice: 'kinect'"),
        (["recording"], 2, "required: FILE.jsonl"),
        (["recording", "x", "--speed", "-1"], 2, "less than 0"),
        (["recording", "x", "--port", "0"], 2, "not a port"),
        (["leap", "--duration", "soon"], 2, "not a number"),
        (["mediapipe", "--field-of-view", "400"], 2, "between 10 and 170"),
        (["hts", "--listen", "here:there"], 2, "not a port"),
        (["recording", "nowhere.jsonl"], 1, "The recording nowhere.jsonl does not exist"),
        (["leap", "nowhere.json"], 1, "The recording nowhere.json does not exist"),
        (["mediapipe", "--environment", "nowhere"], 1, "track mediapipe --setup"),
        (["leapc", "--library", "nowhere.so"], 1, "LeapC cannot be loaded"),
    ],
)
def test_wrong_usage_is_explained(
    arguments: list[str], code: int, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Return 2 for wrong arguments and 1 for failures, and say why."""
    assert main(["track", *arguments]) == code
    assert words in capfd.readouterr().err


def test_tracking_needs_no_blender(recording: Path) -> None:
    """Send without Blender or Warp being installed."""
    source = (
        "import sys\n"
        "for name in ('bpy', 'mathutils', 'warp', 'trimesh'): sys.modules[name] = None\n"
        "from tactile_clay.clay_addon.command.line import main\n"
        f"sys.exit(main(['track', 'recording', {str(recording)!r}, '--speed', '0']))"
    )
    result = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (0, "52 datagrams sent.\n"), result.stderr


def test_interrupted_sender_completes_its_recording(
    recording: Path, tmp_path: Path, receiver: Receiver
) -> None:
    """Exit successfully on Ctrl-C, with a complete recording."""
    target = tmp_path / "kept.jsonl"
    arguments = ["track", "recording", str(recording), "--loop", "--record", str(target)]
    arguments += ["--port", str(receiver.address[1])]
    # Processes that a shell runs in the background, and their children, ignore interrupts.
    source = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from tactile_clay.clay_addon.command.line import main; "
        f"sys.exit(main({arguments!r}))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", source], stderr=subprocess.PIPE, text=True
    ) as process:
        seen = 0
        while seen < 20 and process.poll() is None:
            seen += len(receiver.drain())
        process.send_signal(2)
        assert process.wait(timeout=30) == 0
    assert len(read_recording(target)) >= 10
