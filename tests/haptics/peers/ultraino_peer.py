# SPDX-License-Identifier: GPL-3.0-or-later
"""A simulated Ultraino board in a separate process.

Its arguments are fpga, fpga128 or mega, and the number of boards.
"""

from __future__ import annotations

import sys
from typing import Any

from tactile_clay.tests.haptics.peers.serial_peer import Board, serve


class Fpga:
    """SimpleFPGA: two patterns of phases and pulse widths, exchanged by the byte 253."""

    def __init__(self, *, emitters: int, divisions: int) -> None:
        self.emitters = emitters
        self.divisions = divisions
        self.exchanges = 0
        self.power_up()

    def power_up(self) -> None:
        """Switch all transducers on, in phase."""
        self.phases = [[0] * self.emitters, [0] * self.emitters]
        self.widths = [[self.divisions // 2] * self.emitters for _ in range(2)]
        self.current = 0
        self.target: list[int] = []
        self.counter = self.emitters

    def feed(self, data: bytes) -> bytes:
        # The byte 192 enables all boards; this one is always enabled.
        for byte in data.replace(b"\xc0", b""):
            if byte in (254, 251):
                self.target = (self.phases if byte == 254 else self.widths)[1 - self.current]
                self.counter = 0
            elif byte == 253:
                self.current = 1 - self.current
                self.exchanges += 1
                self.counter = self.emitters
            elif byte < 251 and self.counter < self.emitters:
                self.target[self.counter] = byte
                self.counter += 1
        return b""

    def sounds(self) -> bool:
        return any(
            phase < self.divisions and width
            for phase, width in zip(
                self.phases[self.current], self.widths[self.current], strict=True
            )
        )

    def state(self) -> dict[str, Any]:
        return {
            "phases": self.phases[self.current],
            "hidden": self.phases[1 - self.current],
            "widths": self.widths[self.current],
            "exchanges": self.exchanges,
        }


PORTS = DIVISIONS = 10
PATTERNS = 32


class Mega:
    """One Arduino Mega of a chain; the low half of each byte counts down to the board."""

    def __init__(self) -> None:
        self.exchanges = 0
        self.power_up()

    def power_up(self) -> None:
        """Set every pin high in the first half of the first waveform."""
        self.buffers = [bytearray(PATTERNS * DIVISIONS * PORTS) for _ in range(2)]
        self.buffers[0][: DIVISIONS * PORTS // 2] = b"\xff" * (DIVISIONS * PORTS // 2)
        self.durations = [1] + [0] * (PATTERNS - 1)
        self.written_durations = bytearray(PATTERNS)
        self.emitting = 0
        self.index = self.duration_index = 0

    def feed(self, byte: int) -> int:
        """Process a byte, and return what is passed on to the next board."""
        if byte == 0:
            self.emitting = 1 - self.emitting
            self.exchanges += 1
            self.index = self.duration_index = 0
            return byte
        if byte & 0x0F == 1:
            place, low = divmod(self.index, 2)
            buffer = self.buffers[1 - self.emitting]
            buffer[place] = buffer[place] | byte >> 4 if low else byte & 0xF0
            self.index += 1
            return -1
        if byte & 0x3F == 0x30:
            place, quarter = divmod(self.duration_index, 4)
            if quarter == 0:
                self.written_durations[place] = byte & 0xC0
            else:
                self.written_durations[place] |= (byte & 0xC0) >> (2 * quarter)
            self.duration_index += 1
            return byte
        if byte == 0x10:
            self.durations = list(self.written_durations)
            self.duration_index = 0
            return byte
        return byte - 1

    def waveforms(self) -> list[tuple[int, bytes]]:
        """The waveforms emitted in turn: durations in periods, and the bytes of a period."""
        size = DIVISIONS * PORTS
        found = []
        for place, duration in enumerate(self.durations):
            if duration == 0:
                break
            found.append(
                (duration, bytes(self.buffers[self.emitting][place * size : (place + 1) * size]))
            )
        return found


class MegaChain:
    """Boards in a chain, each of which passes data on to the next."""

    def __init__(self, count: int) -> None:
        self.boards = [Mega() for _ in range(count)]

    def power_up(self) -> None:
        for board in self.boards:
            board.power_up()

    def feed(self, data: bytes) -> bytes:
        said = b""
        for byte in data:
            passed = byte
            for board in self.boards:
                passed = board.feed(passed)
                if passed < 0:
                    break
            else:
                said += bytes([passed])
        return said

    def sounds(self) -> bool:
        return any(any(wave) for board in self.boards for _, wave in board.waveforms())

    def state(self) -> dict[str, Any]:
        return {
            "waveforms": [
                [(duration, wave.hex()) for duration, wave in board.waveforms()]
                for board in self.boards
            ],
            "exchanges": self.boards[0].exchanges,
        }


if __name__ == "__main__":
    kind, count = sys.argv[1], int(sys.argv[2])
    board: Board
    if kind == "mega":
        board, baud = MegaChain(count), 115_200
    elif kind == "fpga":
        board, baud = Fpga(emitters=256, divisions=32), 230_400
    else:
        board, baud = Fpga(emitters=72, divisions=128), 1_500_000
    serve(board, baud / 10)
