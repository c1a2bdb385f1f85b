# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting peers and array servers in processes of their own, and looking at both."""

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
"""Nothing that is waited for takes this long [s], however slow the machine."""
OFF_WITHIN = 0.250
"""Sound must be off this soon after its reason has gone [s]."""


@dataclass(frozen=True)
class PlainFoci:
    """Focal points as a test wants them."""

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
    """A peer in a process of its own.

    Args:
        module: Its module beside this one.
        words: Its command line.
    """

    def __init__(self, module: str, *words: str, python: str = sys.executable) -> None:
        self.process = subprocess.Popen(
            [python, "-m", f"tactile_clay.tests.haptics.peers.{module}", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.first: dict[str, Any] = self._line()

    def ask(self, word: str) -> dict[str, Any]:
        """Say a word, and hear what the peer holds."""
        assert self.process.stdin
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()
        return self._line()

    def wait(self, until: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        """Ask again and again until something holds."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            state = self.ask("state")
            if until(state):
                return state
            time.sleep(0.005)
        raise AssertionError(f"{what} did not happen; the peer holds {state}")

    def _line(self) -> dict[str, Any]:
        assert self.process.stdout
        line = self.process.stdout.readline()
        assert line, "the peer has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End it."""
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
    """A peer for as long as the block lasts."""
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
    """Send the same focal points at a live scene's pace until something holds."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        out.send(points)
        if until():
            return
        time.sleep(pace)
    raise AssertionError(f"{what} did not happen; the server says {out.status()}")


def lateness(board: Peer, since: float) -> float:
    """Wait for lasting silence, and tell how long after `since` it came [s].

    What the machine kept the board itself waiting is not counted.
    """
    before = board.ask("state")["held_up"]
    state = board.wait(
        lambda state: not state["sounds"] and state["time"] > since + 0.4, "lasting silence"
    )
    late: float = state["changes"][-1][0] - since - (state["held_up"] - before)
    return late


class Crowding:
    """How long the machine keeps a process waiting that wants to run, because of other things."""

    def __init__(self) -> None:
        self.longest = 0.0
        """The longest that a sleep of 5 ms took longer [s]."""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._sleep, daemon=True)

    def _sleep(self) -> None:
        while not self._ending.is_set():
            begin = time.monotonic()
            time.sleep(0.005)
            self.longest = max(self.longest, time.monotonic() - begin - 0.005)

    def __enter__(self) -> Crowding:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()


def check_lateness(attempt: Callable[[], float], limit: float = OFF_WITHIN) -> None:
    """Hold the best of three attempts to a limit.

    Client, server and board each may have been kept waiting as long as anybody on this machine.
    """
    tries: list[tuple[float, float]] = []
    while len(tries) < 3:
        with Crowding() as crowding:
            late = attempt()
        tries.append((late, crowding.longest))
        if late <= limit + 3.0 * crowding.longest:
            return
    raise AssertionError(f"(silent after, kept waiting) {tries} s, not within {limit}")


def pressures_at(
    array: TransducerArray, drive: NDArray[np.complexfloating], points: ArrayLike
) -> NDArray[np.float64]:
    """Pressure amplitude that a drive gives at points [Pa], shape [K]."""
    return np.abs(acoustic_field(array, drive, points))
