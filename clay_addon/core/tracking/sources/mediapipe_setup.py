# SPDX-License-Identifier: GPL-3.0-or-later
"""MediaPipe's own environment: made by one command, never by Blender.

MediaPipe needs OpenCV and a numpy of its own, half a gigabyte in all, so that it lives apart. Its
current version runs the models but does not bring them; an earlier one brings them, of which only
the two files of hands are taken and put into one file as the current version wants them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path

from .. import TrackingError

RUNTIME = "mediapipe==1.2.2"
_MODELS = "mediapipe==0.10.21"
"""The last version with the hand models in its wheel."""
_MODEL_FILES = {
    "hand_detector.tflite": "mediapipe/modules/palm_detection/palm_detection_full.tflite",
    "hand_landmarks_detector.tflite": "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
}
MODEL = "hand_landmarker.task"
_DONE = "installed.stamp"


def default_environment() -> Path:
    """The folder of the environment unless another is named."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_DATA_HOME", Path.home() / ".local" / "share"))
    return base / "tactile-clay" / "mediapipe"


def environment_python(folder: Path) -> Path:
    """The environment's Python.

    Raises:
        TrackingError: The environment is not there, or was not made to its end.
    """
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if not (folder / _DONE).is_file() or not python.exists():
        raise TrackingError(
            f"MediaPipe is not set up in {folder}. Run once: tactile-clay track mediapipe --setup"
        )
    return python


def set_up(folder: Path, *, tell: Callable[[str], None] = print) -> None:
    """Make the environment, some 650 MB; one that stands is left as it is.

    Args:
        folder: Where to.
        tell: Is told what is being done.

    Raises:
        TrackingError: It cannot be made; the message has what pip said.
    """
    if (folder / _DONE).is_file():
        tell(f"MediaPipe is set up in {folder}.")
        return
    if folder.exists() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").is_file():
        raise TrackingError(f"{folder} is no environment; name an empty folder with --environment.")
    tell(f"Making an environment in {folder} …")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        venv.create(folder, with_pip=True, clear=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise TrackingError(f"An environment cannot be made in {folder} ({error}).") from error
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    tell(f"Installing {RUNTIME} …")
    _pip(python, "install", RUNTIME)
    tell("Fetching the hand models …")
    make_model(python, folder / MODEL)
    (folder / _DONE).write_text(f"{RUNTIME}\n", encoding="utf-8")
    tell("Done. Try: tactile-clay track mediapipe --camera 0")


def make_model(python: Path, target: Path) -> None:
    """Fetch the two models and put them into one uncompressed file.

    Raises:
        TrackingError: They cannot be had.
    """
    with tempfile.TemporaryDirectory(prefix="tactile-clay-") as scratch:
        # Models are the same for every machine, so one wheel serves all.
        options = ["--no-deps", "--only-binary=:all:", "--python-version", "3.11"]
        options += ["--platform", "manylinux_2_28_x86_64", "--dest", scratch]
        _pip(python, "download", *options, _MODELS)
        wheels = list(Path(scratch).glob("mediapipe-*.whl"))
        try:
            with zipfile.ZipFile(wheels[0]) as wheel:
                models = {name: wheel.read(path) for name, path in _MODEL_FILES.items()}
        except (IndexError, KeyError, OSError, zipfile.BadZipFile) as error:
            raise TrackingError(f"{_MODELS} holds no hand models ({error}).") from error
    partial = target.with_suffix(".part")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as archive:
        for name, data in models.items():
            archive.writestr(name, data)
    partial.replace(target)


def _pip(python: Path, command: str, *arguments: str) -> None:
    result = subprocess.run(
        [str(python), "-m", "pip", command, "--quiet", "--no-input", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise TrackingError(f"pip could not {command} {arguments[-1]}:\n{result.stderr.strip()}")
