# SPDX-License-Identifier: GPL-3.0-or-later
"""MediaPipe's worker, with fakes of MediaPipe and OpenCV: how it calls them and what it prints.

MediaPipe itself is too large for the tests; with it the worker was tested by hand.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tactile_clay.clay_addon.core.tracking.sources import mediapipe_worker

CV2 = """
import numpy as np

COLOR_BGR2RGB, CAP_PROP_POS_MSEC, CAP_PROP_BUFFERSIZE = 4, 0, 38

def setNumThreads(count): pass
def cvtColor(picture, code): return picture[:, :, ::-1]
def imread(name): return None if "bad" in name else np.zeros((48, 64, 3), np.uint8)

class VideoCapture:
    def __init__(self, name):
        self.name, self.count = name, 0
    def isOpened(self): return self.name != 7
    def set(self, key, value): pass
    def get(self, key): return 40.0 * (self.count - 1)
    def read(self):
        self.count += 1
        return self.count <= 3, np.zeros((48, 64, 3), np.uint8)
    def release(self): pass
"""
MEDIAPIPE = """
class ImageFormat:
    SRGB = 1

class Image:
    def __init__(self, image_format, data):
        assert data.shape == (48, 64, 3)
"""
VISION = """
from types import SimpleNamespace

class RunningMode:
    IMAGE, VIDEO = "image", "video"

HandLandmarkerOptions = SimpleNamespace

class HandLandmarker:
    times = []

    @classmethod
    def create_from_options(cls, options):
        assert options.num_hands == 2
        detector = cls()
        detector.mode = options.running_mode
        return detector

    def detect(self, image):
        assert self.mode == "image"
        point = SimpleNamespace(x=0.5, y=0.25, z=0.125)
        name = SimpleNamespace(category_name="Right", score=0.75)
        return SimpleNamespace(
            handedness=[[name]], hand_landmarks=[[point] * 21], hand_world_landmarks=[[point] * 21]
        )

    def detect_for_video(self, image, time):
        assert self.mode == "video"
        assert not self.times or time > self.times[-1]
        self.times.append(time)
        return SimpleNamespace(handedness=[], hand_landmarks=[], hand_world_landmarks=[])

    def close(self):
        print("closed", file=__import__("sys").stderr)
"""


@pytest.fixture
def modules(tmp_path: Path) -> Path:
    """A folder with the fake modules."""
    package = tmp_path / "mediapipe" / "tasks" / "python"
    package.mkdir(parents=True)
    (tmp_path / "cv2.py").write_text(CV2)
    (tmp_path / "mediapipe" / "__init__.py").write_text(MEDIAPIPE)
    (tmp_path / "mediapipe" / "tasks" / "__init__.py").write_text("")
    (package / "__init__.py").write_text(
        "from types import SimpleNamespace\nBaseOptions = SimpleNamespace\nfrom . import vision\n"
    )
    (package / "vision.py").write_text(VISION)
    return tmp_path


def run(modules: Path, *inputs: str) -> subprocess.CompletedProcess[str]:
    """Run the worker as its parent does: by path, without this package."""
    return subprocess.run(
        [sys.executable, str(mediapipe_worker.__file__), "--model", "hands.task", *inputs],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(modules)},
        check=False,
    )


def test_images_give_a_line_each(modules: Path) -> None:
    """Print time, size and hands of each image, and close the detector."""
    result = run(modules, "a.png", "b.JPG")
    assert result.returncode == 0, result.stderr
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [record["time"] for record in records] == [0, 1_000_000_000]
    assert (records[0]["width"], records[0]["height"]) == (64, 48)
    (hand,) = records[0]["hands"]
    assert (hand["side"], hand["score"]) == ("Right", 0.75)
    assert hand["image"] == [[0.5, 0.25]] * 21
    assert hand["world"] == [[0.5, 0.25, 0.125]] * 21
    assert "closed" in result.stderr


def test_video_gives_its_own_times(modules: Path) -> None:
    """Print a line per image with the video's time, even without hands."""
    result = run(modules, "a.mp4")
    assert result.returncode == 0, result.stderr
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [record["time"] for record in records] == [0, 40_000_000, 80_000_000]
    assert all(record["hands"] == [] for record in records)


@pytest.mark.parametrize(
    ("name", "words"),
    [("bad.png", "bad.png is not a readable image"), ("7", "The camera 7 cannot be opened")],
)
def test_input_that_cannot_be_opened_is_named(modules: Path, name: str, words: str) -> None:
    """Exit with 1 and name the input."""
    result = run(modules, name)
    assert result.returncode == 1
    assert words in result.stderr
