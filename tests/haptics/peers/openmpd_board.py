# SPDX-License-Identifier: GPL-3.0-or-later
"""A simulated OpenMPD board in a separate process, on a socket instead of USB.

The socket receives the calls of a pyusb backend, one line of JSON each, and answers each with a
line. Commands on standard input: ``state``, ``stall``, ``resume``, ``unplug``, ``plug``,
``reboot``.
"""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
import sys
import time
from typing import Any

OFF = {"phases": [0] * 256, "widths": [0] * 256}


class OpenMPDBoard:
    """Receives messages of 512 bytes, whose first byte has a flag."""

    def __init__(self) -> None:
        self.plugged, self.stalled = True, False
        self.messages = 0
        self.controls: list[list[int]] = []
        self.power_up()

    def power_up(self) -> None:
        """Switch all transducers on, in phase."""
        self.phases, self.widths = [0] * 256, [64] * 256
        self.index = 512
        self.buffer = bytearray(512)

    def feed(self, data: bytes) -> None:
        """Process bytes from the FIFO."""
        for byte in data:
            if byte >= 128 and self.index != 25:
                self.index = 0
            if self.index < 512:
                self.buffer[self.index] = byte
                self.index += 1
                if self.index == 512:
                    self.phases = [value & 127 for value in self.buffer[:256]]
                    self.widths = list(self.buffer[256:])
                    self.messages += 1

    def sounds(self) -> bool:
        """Whether any transducer emits."""
        return any(self.widths)


def main() -> None:
    board = OpenMPDBoard()
    changes = [(time.monotonic(), board.sounds())]
    server = socket.create_server(("127.0.0.1", 0))
    print(json.dumps({"port": server.getsockname()[1]}), flush=True)
    selector = selectors.DefaultSelector()
    selector.register(server, selectors.EVENT_READ, "server")
    selector.register(sys.stdin, selectors.EVENT_READ, "person")
    readers: dict[socket.socket, Any] = {}
    loudest: dict[str, Any] = {}
    while True:
        for key, _ in selector.select():
            if key.data == "server":
                connection, _ = server.accept()
                selector.register(connection, selectors.EVENT_READ, "backend")
                readers[connection] = connection.makefile("r")
            elif key.data == "person":
                word = sys.stdin.readline().strip()
                if not word:
                    return
                if word in ("stall", "resume"):
                    board.stalled = word == "stall"
                elif word in ("plug", "unplug"):
                    board.plugged = word == "plug"
                elif word == "reboot":
                    board.power_up()
                    changes.append((time.monotonic(), True))
                print(
                    json.dumps(
                        {
                            "time": time.monotonic(),
                            "sounds": board.sounds(),
                            "changes": changes[-400:],
                            "held_up": 0.0,
                            "messages": board.messages,
                            "controls": board.controls[-6:],
                            "loudest": loudest,
                        }
                    ),
                    flush=True,
                )
            else:
                assert isinstance(key.fileobj, socket.socket)
                # A server that is killed may leave an incomplete line.
                try:
                    call = json.loads(readers[key.fileobj].readline())
                except (OSError, ValueError):
                    selector.unregister(key.fileobj)
                    key.fileobj.close()
                    continue
                answer = "ok"
                if not board.plugged:
                    answer = "gone"
                elif call["name"] == "write" and board.stalled:
                    answer = "timeout"
                elif call["name"] == "write":
                    board.feed(bytes.fromhex(call["data"]))
                    if board.sounds():
                        loudest = {"phases": board.phases, "widths": board.widths}
                    if board.sounds() != changes[-1][1]:
                        changes.append((time.monotonic(), board.sounds()))
                elif call["name"] == "control":
                    board.controls.append(call["values"])
                with contextlib.suppress(OSError):
                    key.fileobj.sendall((json.dumps(answer) + "\n").encode())


if __name__ == "__main__":
    main()
