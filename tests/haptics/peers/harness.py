# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts simulated devices in separate processes, and checks what they emit."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_clay.haptics import ArrayClient, TransducerArray, acoustic_field

PATIENCE = 20.0
"""Maximum time to wait for anything, also on a slow machine [s]."""
OFF_WITHIN = 0.250
"""Maximum time for which there may be sound after its cause has ended [s]."""


@dataclass(frozen=True)
class PlainFoci:
    """Focal points to send in a test."""

    positions: NDArray[np.float64]
    """Positions [m], shape [K, 3]."""
    pressures: NDArray[np.float64]
    """Pressures [Pa], shape [K]."""


def foci(*rows: tuple[float, float, float, float]) -> PlainFoci:
    """Focal points from rows of x, y, z [m] and pressure [Pa]."""
    table = np.array(rows, np.float64).reshape(-1, 4)
    return PlainFoci(table[:, :3], table[:, 3])


TWO_FOCI = foci((0.0, 0.0, 0.15, 900.0), (0.03, 0.02, 0.14, 500.0))


class Peer:
    """A simulated device in a separate process.

    Args:
        module: Name of its module in this folder.
        arguments: Its command-line arguments.
    """

    def __init__(self, module: str, *arguments: str, python: str = sys.executable) -> None:
        self.process = subprocess.Popen(
            [python, "-m", f"tactile_clay.tests.haptics.peers.{module}", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.first: dict[str, Any] = self._line()

    def ask(self, command: str) -> dict[str, Any]:
        """Send a command, and return the peer's state."""
        assert self.process.stdin
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self._line()

    def wait(self, until: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        """Ask repeatedly until a condition is true, and return the state."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            state = self.ask("state")
            if until(state):
                return state
            time.sleep(0.005)
        raise AssertionError(f"{what} did not happen; the peer's state is {state}")

    def _line(self) -> dict[str, Any]:
        assert self.process.stdout
        line = self.process.stdout.readline()
        assert line, "the peer has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin
        self.process.stdin.close()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        assert self.process.stdout
        self.process.stdout.close()


@contextmanager
def peer(module: str, *words: str) -> Iterator[Peer]:
    """A peer that ends with the block."""
    started = Peer(module, *words)
    try:
        yield started
    finally:
        started.close()


def keep_sending(
    out: ArrayClient,
    points: PlainFoci,
    until: Callable[[], bool],
    what: str,
    *,
    pace: float = 1 / 60,
) -> None:
    """Send the same focal points at the rate of a live scene until a condition is true."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        out.send(points)
        if until():
            return
        time.sleep(pace)
    raise AssertionError(f"{what} did not happen; the server's status is {out.status()}")


def lateness(board: Peer, since: float) -> float:
    """Wait for lasting silence, and return how long after `since` it began [s].

    Time for which the machine delayed the board's own process is not counted.
    """
    before = board.ask("state")["held_up"]
    state = board.wait(
        lambda state: not state["sounds"] and state["time"] > since + 0.4, "lasting silence"
    )
    late: float = state["changes"][-1][0] - since - (state["held_up"] - before)
    return late


class SchedulingDelay:
    """Measures how long the machine delays a process that is ready to run."""

    def __init__(self) -> None:
        self.longest = 0.0
        """The longest delay of a 5 ms sleep [s]."""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._sleep, daemon=True)

    def _sleep(self) -> None:
        while not self._ending.is_set():
            begin = time.monotonic()
            time.sleep(0.005)
            self.longest = max(self.longest, time.monotonic() - begin - 0.005)

    def __enter__(self) -> SchedulingDelay:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()


def check_lateness(attempt: Callable[[], float], limit: float = OFF_WITHIN) -> None:
    """Check that the best of three attempts is within a limit.

    Allows for the scheduling delay of three processes: client, server and board.
    """
    tries: list[tuple[float, float]] = []
    while len(tries) < 3:
        with SchedulingDelay() as delay:
            late = attempt()
        tries.append((late, delay.longest))
        if late <= limit + 3.0 * delay.longest:
            return
    raise AssertionError(f"(silent after, scheduling delay) {tries} s, not within {limit}")


def pressures_at(
    array: TransducerArray, drive: NDArray[np.complexfloating], points: ArrayLike
) -> NDArray[np.float64]:
    """Pressure amplitude of a drive at points [Pa], shape [K]."""
    return np.abs(acoustic_field(array, drive, points))
