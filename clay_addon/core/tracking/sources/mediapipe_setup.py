# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets up MediaPipe in an environment of its own: by a command, never from Blender.

MediaPipe needs OpenCV and another version of numpy, half a gigabyte in all, so it is kept separate.
Its current version runs the hand models but does not contain them. They are extracted from an older
version's wheel and packed into one file, as the current version expects.
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
    """The default folder of the environment."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_DATA_HOME", Path.home() / ".local" / "share"))
    return base / "tactile-clay" / "mediapipe"


def environment_python(folder: Path) -> Path:
    """The Python executable of an environment.

    Raises:
        TrackingError: The environment does not exist, or its setup was not completed.
    """
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if not (folder / _DONE).is_file() or not python.exists():
        raise TrackingError(
            f"MediaPipe is not set up in {folder}. Run once: tactile-clay track mediapipe --setup"
        )
    return python


def set_up(folder: Path, *, report: Callable[[str], None] = print) -> None:
    """Create the environment (650 MB); a complete one is left as it is.

    Args:
        folder: Folder of the environment.
        report: Receives progress messages.

    Raises:
        TrackingError: It cannot be created; the message includes pip's output.
    """
    if (folder / _DONE).is_file():
        report(f"MediaPipe is already set up in {folder}.")
        return
    if folder.exists() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").is_file():
        raise TrackingError(
            f"{folder} is not an environment; choose an empty folder with --environment."
        )
    report(f"Creating an environment in {folder} …")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        venv.create(folder, with_pip=True, clear=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise TrackingError(f"Cannot create an environment in {folder} ({error}).") from error
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    report(f"Installing {RUNTIME} …")
    _pip(python, "install", RUNTIME)
    report("Fetching the hand models …")
    make_model(python, folder / MODEL)
    (folder / _DONE).write_text(f"{RUNTIME}\n", encoding="utf-8")
    report("Done. Try: tactile-clay track mediapipe --camera 0")


def make_model(python: Path, target: Path) -> None:
    """Download the two models and pack them into one uncompressed file.

    Args:
        python: Python executable whose pip downloads them.
        target: The file to write.

    Raises:
        TrackingError: The download failed, or contains no models.
    """
    with tempfile.TemporaryDirectory(prefix="tactile-clay-") as scratch:
        # The models do not depend on the platform, so one wheel serves all.
        options = ["--no-deps", "--only-binary=:all:", "--python-version", "3.11"]
        options += ["--platform", "manylinux_2_28_x86_64", "--dest", scratch]
        _pip(python, "download", *options, _MODELS)
        wheels = list(Path(scratch).glob("mediapipe-*.whl"))
        try:
            with zipfile.ZipFile(wheels[0]) as wheel:
                models = {name: wheel.read(path) for name, path in _MODEL_FILES.items()}
        except (IndexError, KeyError, OSError, zipfile.BadZipFile) as error:
            raise TrackingError(f"{_MODELS} contains no hand models ({error}).") from error
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
