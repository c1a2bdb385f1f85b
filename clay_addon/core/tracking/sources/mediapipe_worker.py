# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs MediaPipe in its own environment and prints detected hands, one JSON object per line.

This file is run by path with that environment's Python. It imports nothing from this package, which
is not installed there.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")


def main() -> int:
    """Detect hands until the input ends.

    Returns:
        The exit code: 1 if the input cannot be opened.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("inputs", nargs="+")
    parser.add_argument("--model", required=True)
    parser.add_argument("--confidence", type=float, default=0.5)
    options = parser.parse_args()
    import cv2
    import mediapipe
    from mediapipe.tasks.python import BaseOptions, vision

    cv2.setNumThreads(1)
    stills = all(Path(name).suffix.lower() in _IMAGES for name in options.inputs)
    mode = vision.RunningMode.IMAGE if stills else vision.RunningMode.VIDEO
    detector = vision.HandLandmarker.create_from_options(
        vision.HandLandmarkerOptions(
            base_options=BaseOptions(model_asset_path=options.model),
            running_mode=mode,
            num_hands=2,
            min_hand_detection_confidence=options.confidence,
            min_hand_presence_confidence=options.confidence,
            min_tracking_confidence=options.confidence,
        )
    )
    source = _stills(cv2, options.inputs) if stills else _video(cv2, options.inputs)
    last = -1
    try:
        for moment, pixels in source:
            image = mediapipe.Image(
                image_format=mediapipe.ImageFormat.SRGB,
                data=cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB),
            )
            if stills:
                result = detector.detect(image)
            else:
                # MediaPipe requires strictly increasing times [ms].
                last = max(last + 1, moment // 1_000_000)
                result = detector.detect_for_video(image, last)
            print(json.dumps(_record(moment, pixels.shape, result)), flush=True)
    except _InputError as error:
        print(error, file=sys.stderr)
        return 1
    except BrokenPipeError:
        return 0
    finally:
        detector.close()
    return 0


class _InputError(Exception):
    """An image, a video or a camera cannot be opened."""


def _stills(cv2: Any, names: list[str]) -> Iterator[tuple[int, Any]]:
    """Yield the time [ns] and the pixels of each image, one second apart."""
    for index, name in enumerate(names):
        pixels = cv2.imread(name)
        if pixels is None:
            raise _InputError(f"{name} is not a readable image.")
        yield index * 1_000_000_000, pixels


def _video(cv2: Any, names: list[str]) -> Iterator[tuple[int, Any]]:
    """Yield the time [ns] and the pixels of each image of videos or a camera."""
    for name in names:
        live = name.isdigit()
        capture = cv2.VideoCapture(int(name) if live else name)
        if not capture.isOpened():
            kind = f"The camera {name}" if live else f"The video {name}"
            raise _InputError(f"{kind} cannot be opened.")
        if live:
            # Buffered images would only add delay.
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        try:
            while True:
                good, pixels = capture.read()
                moment = (
                    time.perf_counter_ns()
                    if live
                    else round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1_000_000)
                )
                if not good:
                    break
                yield moment, pixels
        finally:
            capture.release()


def _record(moment: int, shape: tuple[int, ...], result: Any) -> dict[str, Any]:
    hands = []
    for handedness, image, world in zip(
        result.handedness, result.hand_landmarks, result.hand_world_landmarks, strict=True
    ):
        hands.append(
            {
                "side": handedness[0].category_name,
                "score": handedness[0].score,
                "image": [[point.x, point.y] for point in image],
                "world": [[point.x, point.y, point.z] for point in world],
            }
        )
    return {"time": moment, "width": shape[1], "height": shape[0], "hands": hands}


if __name__ == "__main__":
    sys.exit(main())
