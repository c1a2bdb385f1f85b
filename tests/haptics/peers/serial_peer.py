# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that simulates a serial array on a pty, controlled by commands on standard input.

It reads the pty no faster than its baud rate, because a pty has none. Each command on standard
input is answered with a line of JSON:

    state    report the state, and when sound started and ended
    stall    stop reading        resume  read again
    reboot   power off and on    hangup  unplug (closes the pty)
    replug   plug in again (opens a new pty)
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import time
import tty
from typing import Any, Protocol


class Board(Protocol):
    """A simulated board."""

    def feed(self, data: bytes) -> bytes:
        """Process bytes, and return the answer."""

    def power_up(self) -> None:
        """Go to the state after power-up."""

    def sounds(self) -> bool:
        """Whether any transducer emits."""

    def state(self) -> dict[str, Any]:
        """The board's state, for JSON."""


def serve(board: Board, bytes_per_second: float) -> None:
    """Simulate the board until standard input ends."""
    master, slave = _plug_in()
    print(json.dumps({"port": os.ttyname(slave)}), flush=True)
    changes = [(time.monotonic(), board.sounds())]
    read, stalled, plugged = 0, False, True
    budget, last = 0.0, time.monotonic()
    max_budget = max(1.0, bytes_per_second * 0.004)
    held_up = 0.0
    while True:
        listening = [0] + ([master] if plugged and not stalled and budget >= 1.0 else [])
        ready, _, _ = select.select(listening, [], [], 0.001)
        now = time.monotonic()
        # A busy machine delays this process.
        held_up += max(0.0, now - last - 0.02)
        budget, last = min(max_budget, budget + (now - last) * bytes_per_second), now
        if master in ready:
            with contextlib.suppress(BlockingIOError):
                data = os.read(master, int(budget))
                budget -= len(data)
                read += len(data)
                for byte in data:
                    answer = board.feed(bytes([byte]))
                    if answer:
                        with contextlib.suppress(BlockingIOError):
                            os.write(master, answer)
                    if board.sounds() != changes[-1][1]:
                        changes.append((now, not changes[-1][1]))
        if 0 in ready:
            commands = os.read(0, 4096).decode().split()
            if not commands:
                return
            for command in commands:
                if command == "reboot":
                    board.power_up()
                    changes.append((now, board.sounds()))
                elif command == "hangup":
                    os.close(slave)
                    os.close(master)
                    plugged = False
                elif command == "replug":
                    master, slave = _plug_in()
                    plugged = True
                elif command in ("stall", "resume"):
                    stalled = command == "stall"
                answer_line = {
                    "time": now,
                    "read": read,
                    "held_up": held_up,
                    "port": os.ttyname(slave) if plugged else "",
                    "sounds": board.sounds(),
                    "changes": changes[-400:],
                    **board.state(),
                }
                print(json.dumps(answer_line), flush=True)


def _plug_in() -> tuple[int, int]:
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, slave
