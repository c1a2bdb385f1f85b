# SPDX-License-Identifier: GPL-3.0-or-later
"""The Leap service's websocket, tested with a server that imitates the service."""

import json
import sys
import threading
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
import pytest
from websockets.sync.server import ServerConnection, serve

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.protocol.joints import WRIST
from tactile_clay.clay_addon.core.tracking.sources.leap import leap_service
from tactile_clay.tests.clay_addon.core.tracking.formats.test_leap import leap_hand, message


class Service:
    """Implements protocol 6: sends a greeting, receives settings, then sends frames."""

    def __init__(self) -> None:
        self.version = 6
        self.paths: list[str] = []
        self.wishes: list[Any] = []
        self.frames: list[str] = []
        self.connections = 0

    def __call__(self, connection: ServerConnection) -> None:
        self.connections += 1
        assert connection.request is not None
        self.paths.append(connection.request.path)
        connection.send(json.dumps({"serviceVersion": "2.3.1", "version": self.version}))
        self.wishes = [json.loads(connection.recv(timeout=5)) for _ in range(3)]
        for frame in self.frames:
            connection.send(frame)


@pytest.fixture
def service() -> Iterator[tuple[Service, str]]:
    """A service on a port of loopback, and its address."""
    behavior = Service()
    with serve(behavior, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        port = server.socket.getsockname()[1]
        yield behavior, f"ws://127.0.0.1:{port}/v6.json"
        server.shutdown()
        thread.join()


def frames(count: int) -> list[str]:
    """Frames of a moving hand, 100 frames/s on the device's clock."""
    return [
        json.dumps(
            message(leap_hand(at=(0.001 * number, 0.2, 0.0)), timestamp=77_000 + 10_000 * number)
        )
        for number in range(count)
    ]


def test_hands_are_read_from_the_service(service: tuple[Service, str]) -> None:
    """Request protocol 6 and frames in the background, and read the frames."""
    behavior, address = service
    behavior.frames = [*frames(3), "no json", "[1, 2]", json.dumps({"event": {}}), *frames(5)[3:]]
    stream = leap_service(address, sleep=lambda _: None)
    seen = list(islice(stream, 5))
    stream.close()
    assert behavior.paths == ["/v6.json"]
    assert {"background": True} in behavior.wishes
    places = [item.frames[0].positions[WRIST, 0] for item in seen]
    assert np.allclose(places, 0.001 * np.arange(5), atol=1e-5)
    times = [item.frames[0].source_time for item in seen]
    assert times == sorted(times)
    assert all(list(item.absent) == ["left"] for item in seen)


def test_lost_connection_is_restored(service: tuple[Service, str]) -> None:
    """Reconnect after the service closed the connection, and report that it is waited for."""
    behavior, address = service
    behavior.frames = frames(2)
    messages: list[str] = []
    stream = leap_service(address, sleep=lambda _: None, report=messages.append)
    seen = [item for item in islice(stream, 8) if item.frames]
    stream.close()
    assert behavior.connections >= 2
    assert len(seen) >= 4
    assert all("waiting for it" in text for text in messages)


def test_absent_service_is_waited_for() -> None:
    """Keep reporting absent hands, and give the reason once."""
    messages: list[str] = []
    stream = leap_service("ws://127.0.0.1:9/v6.json", sleep=lambda _: None, report=messages.append)
    seen = list(islice(stream, 3))
    stream.close()
    assert all(set(item.absent) == {"left", "right"} for item in seen)
    assert len(messages) == 1


def test_old_protocol_is_refused(service: tuple[Service, str]) -> None:
    """Say that a service without bones must be updated."""
    behavior, address = service
    behavior.version = 1
    with pytest.raises(TrackingError, match="protocol 1"):
        next(leap_service(address))


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what to install."""
    monkeypatch.setitem(sys.modules, "websockets", None)
    with pytest.raises(TrackingError, match=r"pip install 'tactile-clay\[leap\]'"):
        next(leap_service())
