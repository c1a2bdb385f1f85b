# SPDX-License-Identifier: GPL-3.0-or-later
"""A simulated SonicSurface in a separate process, written from the table of its protocol.

Its arguments are the firmware, stock or tactile, and the number of boards, 1 or 2.
"""

from __future__ import annotations

import sys
from typing import Any

from tactile_clay.tests.haptics.peers.serial_peer import serve

OFF = 32


class SonicSurfaceBoard:
    """One FPGA: its two patterns, and whether it is selected."""

    def __init__(self, *, tactile: bool, secondary: bool) -> None:
        self.tactile = tactile
        self.select, self.deselect = (193, 192) if secondary else (192, 193)
        self.swaps = 0
        self.power_up()

    def power_up(self) -> None:
        """Start with all transducers on, in phase; with the tactile firmware, start silent."""
        start = OFF if self.tactile else 0
        self.current = [start] * 256
        self.previous = [start] * 256
        self.enabled = True
        self.counter = 0
        self.step = 10
        self.clocks = True

    def feed(self, byte: int) -> None:
        """Process a byte."""
        if byte == 0xFE and self.enabled:
            self.counter = 0
        elif byte == 0xFD:
            self.current, self.previous = self.previous, self.current
            self.counter = 0
            self.swaps += 1
        elif self.tactile and byte >> 5 == 0b101:
            self.step = byte & 0x1F
        elif not self.tactile and byte in (150, 151):
            self.clocks = byte == 151
        elif not self.tactile and byte in (self.select, self.deselect):
            self.enabled = byte == self.select
        elif self.enabled:
            self.previous[self.counter % 256] = OFF if byte == OFF else byte & 0x1F
            self.counter += 1


class SonicSurface:
    """One or two boards on the same wire."""

    def __init__(self, *, tactile: bool, count: int) -> None:
        self.tactile = tactile
        self.boards = [
            SonicSurfaceBoard(tactile=tactile, secondary=secondary)
            for secondary in (False, True)[:count]
        ]

    def feed(self, data: bytes) -> bytes:
        for byte in data:
            for board in self.boards:
                board.feed(byte)
        return b""

    def power_up(self) -> None:
        for board in self.boards:
            board.power_up()

    def pattern(self) -> list[int]:
        """Phase of each of the 256 transducers; 32 is off."""
        wired = 256 // len(self.boards)
        emitted = [phase for board in self.boards for phase in board.current[:wired]]
        # This firmware drops the lowest bit.
        return [phase & 0b111110 for phase in emitted] if self.tactile else emitted

    def sounds(self) -> bool:
        # Only these outputs of a board are connected.
        wired = 256 // len(self.boards)
        return any(set(board.current[:wired]) != {OFF} for board in self.boards if board.clocks)

    def state(self) -> dict[str, Any]:
        return {
            "pattern": self.pattern(),
            "hidden": [
                phase for b in self.boards for phase in b.previous[: 256 // len(self.boards)]
            ],
            "modulation": 1250.0 / (self.boards[0].step + 1) if self.tactile else None,
            "swaps": self.boards[0].swaps,
        }


if __name__ == "__main__":
    serve(SonicSurface(tactile=sys.argv[1] == "tactile", count=int(sys.argv[2])), 230400 / 10)
