# SPDX-License-Identifier: GPL-3.0-or-later
"""The Leap service's websocket as a source of hands.

The service listens on port 6437 of this machine. A client selects protocol 6 by the path, receives
the actual version, asks to be served in the background too, and then receives one JSON object per
frame. Services since Ultraleap Gemini no longer have a websocket; use the source ``leapc`` there.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import replace
from types import ModuleType

from .. import TrackingError
from ..formats.leap import LeapHands
from .sender import ClockMap, Sighting, sighting

ADDRESS = "ws://127.0.0.1:6437/v6.json"
_MAX_MESSAGE_SIZE = 1 << 20
_SILENT_SECONDS = 2.0
_WAIT_SECONDS = 1.0


def leap_service(
    address: str = ADDRESS,
    *,
    sleep: Callable[[float], object] = time.sleep,
    report: Callable[[str], None] = lambda text: print(text, file=sys.stderr, flush=True),
) -> Generator[Sighting, None, None]:
    """Yield the service's hands, without end; reconnects when the service comes and goes.

    Args:
        address: Address of the websocket.
        sleep: Waits for a number of seconds.
        report: Receives messages when the service cannot be reached.

    Raises:
        TrackingError: The websockets library is missing, or the service speaks another protocol.
    """
    client, exceptions = _library()
    hands = LeapHands()
    reported = ""
    while True:
        try:
            with client.connect(
                address, max_size=_MAX_MESSAGE_SIZE, open_timeout=5, compression=None
            ) as connection:
                for setting in ({"enableGestures": False}, {"background": True}, {"focused": True}):
                    connection.send(json.dumps(setting))
                reported = ""
                clock = ClockMap()
                while True:
                    try:
                        message = connection.recv(timeout=_SILENT_SECONDS)
                    except TimeoutError:
                        # A service without a device sends nothing.
                        yield sighting([])
                        continue
                    seen = _sighting(message, hands, clock)
                    if seen is not None:
                        yield seen
        except (OSError, exceptions.WebSocketException) as error:
            text = f"The Leap service does not respond at {address} ({error}); waiting for it."
            if text != reported:
                report(text)
                reported = text
            yield sighting([])
            sleep(_WAIT_SECONDS)


def _sighting(message: str | bytes, hands: LeapHands, clock: ClockMap) -> Sighting | None:
    try:
        content = json.loads(message)
    except (ValueError, RecursionError):
        hands.rejected += 1
        return None
    version = content.get("version") if isinstance(content, dict) else None
    if isinstance(version, int) and version < 5:
        raise TrackingError(
            f"The Leap service uses protocol {version}, which has no bones; update it to a version "
            "with protocol 6."
        )
    frames = hands.read(content)
    if hands.time is None:
        return None
    moment = clock(hands.time)
    return sighting([replace(frame, source_time=moment) for frame in frames], moment)


def _library() -> tuple[ModuleType, ModuleType]:
    try:
        from websockets import exceptions
        from websockets.sync import client
    except ImportError as error:
        raise TrackingError(
            "The websockets library is missing. Install it into this Python: "
            "pip install 'tactile-clay[leap]', or pip install websockets."
        ) from error
    return client, exceptions
