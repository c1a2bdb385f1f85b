# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand Tracking Streamer on a Meta Quest as a source of hands, over UDP."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Generator

from .. import TrackingError
from ..formats.hts import HtsHands
from ..protocol.joints import SIDES
from .sender import Sighting

PORT = 9000
"""The port that the app sends to unless told otherwise."""
_ABSENT = 100_000_000
"""The app sends nothing of a hand it does not see: silent for so long [ns] means not in view."""


def hts_stream(
    host: str = "0.0.0.0",
    port: int = PORT,
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> Generator[Sighting, None, None]:
    """Hands that the app sends, for as long as they are asked for.

    Args:
        host: Address to listen on; by default all of this machine's, since the headset sends over
            the network. What it receives is checked, and goes on to loopback only.
        port: Port to listen on.
        clock: The time [ns].

    Raises:
        TrackingError: The port cannot be had.
    """
    hands = HtsHands()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as incoming:
        try:
            incoming.bind((host, port))
        except (OSError, OverflowError) as error:
            raise TrackingError(
                f"Port {port} of {host} cannot be opened ({error}). Choose another with --listen, "
                "and set the same in the app."
            ) from error
        incoming.settimeout(_ABSENT * 1e-9 / 2)
        seen: dict[str, int] = {}
        while True:
            frames = []
            try:
                data = incoming.recv(1 << 16)
            except OSError:
                # Nothing came, or a datagram that was too long.
                now = clock()
            else:
                now = clock()
                frames = hands.read(data, now)
            seen.update((frame.side, now) for frame in frames)
            absent = [side for side in SIDES if now - seen.get(side, now - 2 * _ABSENT) > _ABSENT]
            if frames or absent:
                yield Sighting(frames, absent, now)
