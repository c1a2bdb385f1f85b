# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures how soon an array is silent after any cause that ends its sound."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tactile_clay.haptics import ArrayClient
from tactile_clay.tests.haptics.peers.harness import TWO_FOCI, Peer, keep_sending, lateness, peer


def _close_input(out: ArrayClient) -> None:
    assert out.process
    assert out.process.stdin
    out.process.stdin.close()


def _send(number: int) -> Callable[[ArrayClient], None]:
    def send(out: ArrayClient) -> None:
        assert out.process
        out.process.send_signal(number)

    return send


ENDS: dict[str, Callable[[ArrayClient], None]] = {
    "no more data": lambda out: None,
    "no focal points": lambda out: out.silence(),
    "lost client": _close_input,
    "SIGTERM": _send(signal.SIGTERM),
}
if hasattr(signal, "SIGKILL"):
    ENDS["server killed (its guard)"] = _send(signal.SIGKILL)
    ENDS["server hangs (its guard)"] = _send(signal.SIGSTOP)


def time_to_silence(board: Peer, end: Callable[[ArrayClient], None]) -> float:
    """Start sound, end it, and return the time until the board is silent [s]."""
    with ArrayClient.start(f"sonicsurface:{board.first['port']},firmware=tactile") as out:
        keep_sending(out, TWO_FOCI, lambda: out.status().frames_per_second > 3, "frames")
        keep_sending(out, TWO_FOCI, lambda: board.ask("state")["sounds"], "sound")
        since = time.monotonic()
        end(out)
        return lateness(board, since)


def measure_silence(*, repeats: int = 5) -> list[dict[str, Any]]:
    """Median and longest time to silence for each cause, with an emulated SonicSurface."""
    results = []
    with peer("sonicsurface_peer", "tactile", "1") as board:
        for name, end in ENDS.items():
            times = [1e3 * time_to_silence(board, end) for _ in range(repeats)]
            results.append(
                {"case": name, "ms_median": float(np.median(times)), "ms_most": max(times)}
            )
    return results


def sentence(figures: dict[str, Any]) -> str:
    """One line about a case."""
    return (
        f"{figures['case']:>28}  silent after {figures['ms_median']:.0f} ms "
        f"(at most {figures['ms_most']:.0f})"
    )
