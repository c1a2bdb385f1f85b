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
"""The app's default port."""
_ABSENCE_TIME = 100_000_000
"""A hand without data for this long is out of view [ns]: the app does not report absent hands."""


def hts_stream(
    host: str = "0.0.0.0",
    port: int = PORT,
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> Generator[Sighting, None, None]:
    """Yield the hands that the app sends, without end.

    Args:
        host: Address to listen on; by default all of this machine's, because the headset sends over
            the network. Data is validated, and forwarded to loopback only.
        port: Port to listen on.
        clock: The time [ns].

    Raises:
        TrackingError: The port cannot be opened.
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
        incoming.settimeout(_ABSENCE_TIME * 1e-9 / 2)
        seen: dict[str, int] = {}
        while True:
            frames = []
            try:
                data = incoming.recv(1 << 16)
            except OSError:
                # Nothing arrived in time, or the datagram was too long.
                now = clock()
            else:
                now = clock()
                frames = hands.read(data, now)
            seen.update((frame.side, now) for frame in frames)
            never = now - 2 * _ABSENCE_TIME
            absent = [side for side in SIDES if now - seen.get(side, never) > _ABSENCE_TIME]
            if frames or absent:
                yield Sighting(frames, absent, now)
