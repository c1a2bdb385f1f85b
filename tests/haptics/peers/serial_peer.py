# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that is a serial array: a pty on one side, a person at the bench on the other.

It reads the pty no faster than a wire of its baud rate brings bytes, since a pty knows no baud
rate. On its standard input it takes a word a line and answers each with a line of JSON:

    state    what the board holds now, and when it began and ceased to sound
    stall    read no more        resume  read again
    reboot   power off and on    hangup  pull the plug (the pty closes)
    replug   put it in again (a new pty)
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
    """A board that understands bytes."""

    def feed(self, data: bytes) -> bytes:
        """Take bytes, and answer with some."""

    def power_up(self) -> None:
        """Begin as after power-up."""

    def sounds(self) -> bool:
        """Whether any transducer emits."""

    def state(self) -> dict[str, Any]:
        """What it holds, for JSON."""


def serve(board: Board, bytes_a_second: float) -> None:
    """Be that board until the standard input ends."""
    master, slave = _plug_in()
    print(json.dumps({"port": os.ttyname(slave)}), flush=True)
    changes = [(time.monotonic(), board.sounds())]
    read, stalled, plugged = 0, False, True
    budget, last = 0.0, time.monotonic()
    longest = max(1.0, bytes_a_second * 0.004)
    held_up = 0.0
    while True:
        listening = [0] + ([master] if plugged and not stalled and budget >= 1.0 else [])
        ready, _, _ = select.select(listening, [], [], 0.001)
        now = time.monotonic()
        # A machine that is busy with other things keeps this process waiting, and others too.
        held_up += max(0.0, now - last - 0.02)
        budget, last = min(longest, budget + (now - last) * bytes_a_second), now
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
            words = os.read(0, 4096).decode().split()
            if not words:
                return
            for word in words:
                if word == "reboot":
                    board.power_up()
                    changes.append((now, board.sounds()))
                elif word == "hangup":
                    os.close(slave)
                    os.close(master)
                    plugged = False
                elif word == "replug":
                    master, slave = _plug_in()
                    plugged = True
                elif word in ("stall", "resume"):
                    stalled = word == "stall"
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
