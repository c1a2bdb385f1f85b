# SPDX-License-Identifier: GPL-3.0-or-later
"""A webcam, a video file or pictures as a source of hands, through MediaPipe."""

from __future__ import annotations

import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from .. import TrackingError
from ..formats.mediapipe import MediapipeHands
from .mediapipe_setup import MODEL, environment_python
from .sender import Sighting, sighting
from .sender_process import NO_WINDOW

_WORKER = Path(__file__).with_name("mediapipe_worker.py")


def mediapipe(
    inputs: Sequence[str],
    environment: Path,
    hands: MediapipeHands,
    *,
    paced: bool = True,
    clock: Callable[[], int] = time.perf_counter_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> Generator[Sighting, None, None]:
    """Hands that MediaPipe sees.

    Args:
        inputs: The number of a camera, a video file, or pictures.
        environment: Folder that `mediapipe_setup.set_up` made.
        hands: What turns its landmarks into hands.
        paced: Whether a video is played at its own pace, and pictures one a second, as far as the
            machine keeps up; else as fast as it goes.
        clock: The time [ns].
        sleep: Waits for so many seconds.

    Raises:
        TrackingError: MediaPipe is not set up, or the input cannot be opened.
    """
    python = environment_python(environment)
    live = len(inputs) == 1 and inputs[0].isdigit()
    for name in inputs:
        if not live and not Path(name).is_file():
            raise TrackingError(f"There is no file {name}.")
    command = [str(python), str(_WORKER), "--model", str(environment / MODEL), *inputs]
    start = None
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        creationflags=NO_WINDOW,
    ) as worker:
        assert worker.stdout is not None
        assert worker.stderr is not None
        said = _Tail(worker.stderr)
        try:
            for line in worker.stdout:
                frames = hands.read(line)
                if hands.time is None:
                    continue
                moment = hands.time
                if not live:
                    start = clock() - hands.time if start is None else start
                    moment = start + hands.time
                    left = moment - clock()
                    if left < 0:
                        # Detection does not keep up, so the video plays more slowly.
                        start, moment = start - left, moment - left
                    elif paced:
                        sleep(left * 1e-9)
                yield sighting([replace(frame, source_time=moment) for frame in frames], moment)
            if worker.wait() != 0:
                raise TrackingError(f"MediaPipe stopped: {said.text()}")
        finally:
            worker.kill()


class _Tail:
    """Reads what a process says, so that it never waits for a reader, and keeps the end of it."""

    def __init__(self, stream: Iterable[str]) -> None:
        self._lines: deque[str] = deque(maxlen=20)
        self._thread = threading.Thread(target=self._read, args=(stream,), daemon=True)
        self._thread.start()

    def _read(self, stream: Iterable[str]) -> None:
        for line in stream:
            # What MediaPipe and OpenCV note of their own doings is nobody's concern.
            if line.strip() and not line.startswith(("INFO", "WARNING", "W0", "I0", "[")):
                self._lines.append(line.strip())

    def text(self) -> str:
        """The last line."""
        self._thread.join(timeout=2.0)
        return self._lines[-1] if self._lines else "it did not say why."
