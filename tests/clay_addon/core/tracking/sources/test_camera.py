# SPDX-License-Identifier: GPL-3.0-or-later
"""MediaPipe's process: how it is started, read and paced, and how failures are explained.

MediaPipe itself is not installed for the tests; a script prints lines in its place.
"""

import json
import sys
from pathlib import Path

import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.formats.mediapipe import MediapipeHands
from tactile_clay.clay_addon.core.tracking.sources import mediapipe_setup
from tactile_clay.clay_addon.core.tracking.sources.camera import mediapipe
from tactile_clay.clay_addon.core.tracking.sources.mediapipe_setup import environment_python, set_up
from tactile_clay.tests.clay_addon.core.tracking.formats.test_mediapipe import GOOD
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, Clock

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")


@pytest.fixture
def environment(tmp_path: Path) -> Path:
    """An environment whose Python ignores its arguments and prints the lines of a file."""
    folder = tmp_path / "environment"
    (folder / "bin").mkdir(parents=True)
    python = folder / "bin" / "python"
    python.write_text(
        f'#!/bin/sh\necho "$@" > {folder}/asked\necho "INFO: nothing" >&2\n'
        f"cat {folder}/lines\ncat {folder}/said >&2\nexit $(cat {folder}/code)\n"
    )
    python.chmod(0o755)
    for name, content in (("installed.stamp", ""), ("lines", ""), ("said", ""), ("code", "0")):
        (folder / name).write_text(content)
    return folder


def image_lines(count: int, step: int) -> str:
    """The worker's lines for images at intervals of ``step`` [ms]."""
    return "".join(
        json.dumps(
            {"time": n * step * MILLISECOND, "width": 640, "height": 480, "hands": [GOOD] * (n % 2)}
        )
        + "\n"
        for n in range(count)
    )


def test_video_plays_at_its_own_speed(environment: Path, tmp_path: Path, clock: Clock) -> None:
    """Give each image the video's time, wait until then, and report absent hands."""
    video = tmp_path / "hands.mp4"
    video.write_text("")
    (environment / "lines").write_text(image_lines(5, 40) + "garbage\n")
    start = clock.now
    seen = list(
        mediapipe(
            [str(video)],
            environment,
            MediapipeHands(),
            clock=clock,
            sleep=lambda seconds: clock.turn(seconds * 1e3),
        )
    )
    assert [len(item.frames) for item in seen] == [0, 1, 0, 1, 0]
    assert [item.time for item in seen] == [start + n * 40 * MILLISECOND for n in range(5)]
    assert seen[1].frames[0].source_time == seen[1].time
    assert clock.now - start == 160 * MILLISECOND
    asked = (environment / "asked").read_text()
    assert "mediapipe_worker.py" in asked
    assert str(video) in asked
    assert "hand_landmarker.task" in asked


def test_video_slows_down_if_detection_does_not_keep_up(
    environment: Path, tmp_path: Path, clock: Clock
) -> None:
    """Give each image the time when it is ready, so that hands do not look old."""
    video = tmp_path / "hands.mp4"
    video.write_text("")
    (environment / "lines").write_text(image_lines(5, 40))
    times = []
    for item in mediapipe([str(video)], environment, MediapipeHands(), clock=clock):
        assert item.time == clock.now
        times.append(item.time)
        clock.turn(70)
    assert times[-1] - times[0] == 4 * 70 * MILLISECOND


def test_images_of_a_camera_keep_their_times(environment: Path) -> None:
    """Use the worker's times for a camera's images, and never wait."""

    def sleep(seconds: float) -> None:
        raise AssertionError

    (environment / "lines").write_text(image_lines(3, 33))
    seen = list(mediapipe(["0"], environment, MediapipeHands(), sleep=sleep))
    assert [item.time for item in seen] == [0, 33 * MILLISECOND, 66 * MILLISECOND]


def test_failing_worker_is_explained(environment: Path) -> None:
    """Show its error message, without MediaPipe's log messages."""
    (environment / "said").write_text(
        "W0000 chatter\n[ WARN:0] noise\nThe camera 7 cannot be opened.\n"
    )
    (environment / "code").write_text("1")
    with pytest.raises(TrackingError, match=r"stopped: The camera 7 cannot be opened\.$"):
        list(mediapipe(["7"], environment, MediapipeHands()))


def test_missing_file_and_missing_setup_are_explained(environment: Path, tmp_path: Path) -> None:
    """Name the missing file, and say how to set up MediaPipe."""
    with pytest.raises(TrackingError, match=r"The file .*nowhere\.mp4 does not exist"):
        next(mediapipe([str(tmp_path / "nowhere.mp4")], environment, MediapipeHands()))
    (environment / "installed.stamp").unlink()
    with pytest.raises(TrackingError, match="tactile-clay track mediapipe --setup"):
        next(mediapipe(["0"], environment, MediapipeHands()))


def test_setup_leaves_other_folders_alone(environment: Path, tmp_path: Path) -> None:
    """Do nothing if it is already set up, and refuse a folder with other content."""
    messages: list[str] = []
    set_up(environment, report=messages.append)
    assert messages == [f"MediaPipe is already set up in {environment}."]
    letters = tmp_path / "letters"
    letters.mkdir()
    (letters / "to-grandmother.txt").write_text("dear grandmother")
    with pytest.raises(TrackingError, match="choose an empty folder"):
        set_up(letters)
    assert (letters / "to-grandmother.txt").read_text() == "dear grandmother"


def test_setup_that_fails_can_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Show pip's message, and do not use an incomplete environment."""
    folder = tmp_path / "new"
    monkeypatch.setattr(mediapipe_setup, "RUNTIME", "/no/such/package")
    monkeypatch.setattr("venv.create", lambda path, **_: (path / "bin").mkdir(parents=True))
    monkeypatch.setattr(mediapipe_setup, "_pip", _failing)
    with pytest.raises(TrackingError, match="no such package"):
        set_up(folder, report=lambda _: None)
    with pytest.raises(TrackingError, match="not set up"):
        environment_python(folder)


def _failing(*_: object) -> None:
    raise TrackingError("no such package")
