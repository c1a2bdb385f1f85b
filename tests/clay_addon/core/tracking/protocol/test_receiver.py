# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver: only loopback, without blocking or raising."""

import random
import socket
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.hand.hand_tracker import HandTracker
from tactile_clay.clay_addon.core.tracking.protocol.packet import PACKET_SIZE, encode
from tactile_clay.clay_addon.core.tracking.protocol.receiver import Receiver
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, Clock, frame_at, shown


@pytest.fixture
def wire(receiver: Receiver) -> Iterator[socket.socket]:
    """A socket that sends to the receiver."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(receiver.address)
        yield wire


def packet(number: int, side: str = "right", **options) -> bytes:
    """The datagram of a hand."""
    return encode(frame_at(number * MILLISECOND, number, side, **options))


def test_it_listens_only_on_loopback(receiver: Receiver) -> None:
    """Bind to 127.0.0.1, and receive nothing sent to another address of this machine."""
    host, port = receiver.address
    assert host == "127.0.0.1"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.sendto(packet(1), ("127.0.0.2", port))
    assert receiver.drain() == []
    assert receiver.rejected == 0


def test_it_does_not_wait(receiver: Receiver) -> None:
    """Return nothing at once if nothing has arrived."""
    assert receiver.drain() == []


def test_new_frames_are_returned_in_order(receiver: Receiver, wire: socket.socket) -> None:
    """Return each hand's frames ascending, without old ones and duplicates."""
    for number in (1, 3, 2, 3, 4):
        wire.send(packet(number))
        wire.send(packet(number, "left"))
    arrivals = receiver.drain()
    for side in ("left", "right"):
        assert [a.frame.sequence for a in arrivals if a.frame.side == side] == [1, 3, 4]
    assert (receiver.accepted, receiver.dropped, receiver.rejected) == (6, 4, 0)
    assert receiver.source == "leap"


def test_flood_is_survived(receiver: Receiver, wire: socket.socket) -> None:
    """Process a bounded number at a time, and find the hand again after 10,000 datagrams."""
    noise = random.Random(7)
    for number in range(10_000):
        if number % 3:
            wire.send(noise.randbytes(noise.choice((1, 100, PACKET_SIZE, 1400))))
        else:
            wire.send(packet(number))
    first = receiver.drain()
    assert len(first) + receiver.dropped + receiver.rejected <= 1024
    while receiver.drain():
        pass
    wire.send(packet(20_000))
    (arrival,) = receiver.drain()
    assert arrival.frame.sequence == 20_000


def test_invalid_datagrams_are_counted_by_reason(receiver: Receiver, wire: socket.socket) -> None:
    """Count short, long, foreign and corrupt datagrams without raising."""
    broken = bytearray(packet(1))
    broken[40:44] = np.float32(np.nan).tobytes()
    wrong = bytearray(packet(1))
    wrong[:4] = b"HAND"
    for data in (b"", b"x", packet(1)[:-1], packet(1) + b"x", bytes(broken), bytes(wrong)):
        wire.send(data)
    assert receiver.drain() == []
    assert receiver.rejected == 6
    assert receiver.reasons == {
        "wrong length": 4,
        "values that are not finite": 1,
        "wrong magic": 1,
    }


mutations = st.lists(
    st.tuples(st.integers(0, PACKET_SIZE - 1), st.integers(0, 255)), max_size=6
).map(dict)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(mutations, st.integers(0, PACKET_SIZE)), max_size=20))
def test_mangled_datagrams_never_raise(receiver: Receiver, wire: socket.socket, datagrams) -> None:
    """Return finite hands or nothing from corrupt datagrams."""
    tracker = HandTracker()
    for number, (changes, cut) in enumerate(datagrams):
        data = bytearray(packet(number))
        for place, value in changes.items():
            data[place] = value
        wire.send(data[:cut] if number % 3 == 0 else data)
    for arrival in receiver.drain():
        tracker.take(arrival.frame, arrival.seen)
        hand = tracker.hand(arrival.frame.side, arrival.seen)
        assert hand is None or np.isfinite(hand.positions).all()


def test_stalled_receiver_shows_no_stale_hand(clock: Clock) -> None:
    """Show a hand as lost whose datagrams were queued while Blender stalled."""
    with Receiver(0, clock=clock) as receiver, socket.socket(type=socket.SOCK_DGRAM) as wire:
        wire.connect(receiver.address)
        tracker = HandTracker()

        def send(count: int) -> None:
            for _ in range(count):
                number = clock.turn(10) // (10 * MILLISECOND)
                place = (1e-5 * (number % 100), 0.2, 0.0)
                wire.send(encode(frame_at(clock.now, number, at=place)))

        def look() -> str:
            for arrival in receiver.drain():
                tracker.take(arrival.frame, arrival.seen)
            return shown(tracker.hand("right", clock.now)).state

        for _ in range(10):
            send(2)
            state = look()
        assert state == "live"
        send(10)
        clock.turn(3000)
        assert look() == "lost"
        send(2)
        assert look() == "live"


def test_rate_and_latency_are_measured(clock: Clock) -> None:
    """Measure the frame rate, and the delay if the clocks are the same."""
    with Receiver(0, clock=clock) as receiver, socket.socket(type=socket.SOCK_DGRAM) as wire:
        wire.connect(receiver.address)
        assert receiver.latency("right") is None
        for number in range(150):
            wire.send(encode(frame_at(clock.now - 7 * MILLISECOND, number)))
            receiver.drain()
            clock.turn(10)
        assert receiver.rate("right") == pytest.approx(100.0, abs=1.0)
        assert receiver.rate("left") == 0.0
        assert receiver.latency("right") == pytest.approx(0.007)
        wire.send(encode(frame_at(1 << 61, 1000)))
        receiver.drain()
        assert receiver.latency("right") is None


sent = st.tuples(st.sampled_from(("left", "right")), st.sampled_from((0, 1, 7, 250, 9_999, 10_000)))


@settings(max_examples=30)
@given(st.lists(sent, max_size=8))
def test_each_hand_has_a_latency_of_its_own(frames) -> None:
    """Tell the delay of a hand's own newest frame, and none of a hand that has not arrived."""
    clock = Clock(now=100_000 * MILLISECOND)
    with Receiver(0, clock=clock) as receiver, socket.socket(type=socket.SOCK_DGRAM) as wire:
        wire.connect(receiver.address)
        expected: dict[str, float | None] = {"left": None, "right": None}
        for number, (side, delay) in enumerate(frames):
            # Each frame is seen later than the one before, however long it takes to arrive.
            clock.turn(20_000)
            wire.send(encode(frame_at(clock.now - delay * MILLISECOND, number, side)))
            assert len(receiver.drain()) == 1
            expected[side] = delay * 1e-3 if delay < 10_000 else None
            for hand, seconds in expected.items():
                measured = receiver.latency(hand)
                assert measured == (None if seconds is None else pytest.approx(seconds))


def test_port_in_use_is_explained(receiver: Receiver) -> None:
    """Name the likely cause and what to do."""
    with pytest.raises(TrackingError, match=r"in use, perhaps by another Blender.*another port"):
        Receiver(receiver.address[1])
    with pytest.raises(TrackingError, match="cannot be opened"):
        Receiver(70_000)


def test_closed_receiver_gives_nothing(receiver: Receiver) -> None:
    """Close twice and drain without an error."""
    receiver.close()
    receiver.close()
    assert receiver.drain() == []
