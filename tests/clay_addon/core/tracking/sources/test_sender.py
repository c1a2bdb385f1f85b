# SPDX-License-Identifier: GPL-3.0-or-later
"""Common parts of senders: sequence numbers, timing and absent hands."""

import io
from pathlib import Path

import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.protocol.receiver import Receiver
from tactile_clay.clay_addon.core.tracking.recording.recording import (
    Entry,
    Recorder,
    read_recording,
)
from tactile_clay.clay_addon.core.tracking.sources.sender import (
    ClockMap,
    Sender,
    Sighting,
    replay,
    run,
    sighting,
)
from tactile_clay.tests.clay_addon.core.tracking.hands import (
    MILLISECOND,
    Clock,
    flat_hand,
    frame_at,
)

ENTRIES = [
    Entry(number * 10 * MILLISECOND, frame_at(number, number, active=number != 2))
    for number in range(4)
]


def test_sightings_are_numbered_and_include_absent_hands(receiver: Receiver) -> None:
    """Send both hands with one sequence number, and an inactive frame for an absent hand."""
    sender = Sender(receiver.address[1])
    sender.send(sighting([frame_at(5)], 5))
    sender.send(sighting([frame_at(6), frame_at(6, side="left")]))
    frames = [arrival.frame for arrival in receiver.drain()]
    sender.close()
    assert [(frame.side, frame.sequence, frame.active) for frame in frames] == [
        ("right", 1, True),
        ("left", 1, False),
        ("right", 2, True),
        ("left", 2, True),
    ]


def test_invalid_frame_is_not_sent(receiver: Receiver) -> None:
    """Count an invalid frame and send the others."""
    joints = flat_hand()
    joints[3] = float("nan")
    sender = Sender(receiver.address[1])
    sender.send(Sighting([frame_at(5, joints=joints), frame_at(5, side="left")]))
    sender.close()
    assert (sender.refused, sender.sent) == (1, 1)
    assert [arrival.frame.side for arrival in receiver.drain()] == ["left"]


def test_sending_without_a_receiver_is_no_error() -> None:
    """Keep sending if no receiver listens, or no longer."""
    with Receiver(0) as receiver:
        port = receiver.address[1]
    sender = Sender(port)
    for _ in range(5):
        sender.send(sighting([frame_at(5)]))
    sender.close()
    assert sender.sent == 10


@pytest.mark.parametrize("speed", [1.0, 2.0, 0.5])
def test_recording_plays_with_its_own_timing(clock: Clock, speed: float) -> None:
    """Wait between frames as recorded, scaled by the speed, and set their times accordingly."""
    start = clock.now
    seen = list(
        replay(ENTRIES, speed=speed, clock=clock, sleep=lambda seconds: clock.turn(seconds * 1e3))
    )
    times = [frame.source_time - start for item in seen for frame in item.frames]
    assert times == pytest.approx([0, 10e6 / speed, 30e6 / speed], abs=2)
    assert seen[2].absent == ["right"]
    assert seen[-1].frames == []
    assert clock.now - start == pytest.approx(30e6 / speed)


def test_slow_machine_catches_up(clock: Clock) -> None:
    """Keep the recording's times if sending takes longer than the gaps."""
    times = []
    for item in replay(ENTRIES, clock=clock, sleep=lambda seconds: clock.turn(seconds * 1e3)):
        times += [frame.source_time for frame in item.frames]
        clock.turn(25)
    assert times[-1] - times[0] == 30 * MILLISECOND


def test_fastest_replay_never_waits_and_keeps_the_order(clock: Clock) -> None:
    """Play as fast as possible at speed 0, each frame with a later time than the last."""

    def sleep(seconds: float) -> None:
        raise AssertionError(f"waited {seconds} s")

    seen = [
        frame.source_time
        for item in replay(ENTRIES, speed=0.0, clock=clock, sleep=sleep)
        for frame in item.frames
    ]
    assert seen == sorted(set(seen))


def test_looping_replay_starts_again(clock: Clock) -> None:
    """Play without end, with ascending times."""
    player = replay(
        ENTRIES, loop=True, clock=clock, sleep=lambda seconds: clock.turn(seconds * 1e3)
    )
    times = [frame.source_time for _ in range(20) for frame in next(player).frames]
    assert len(times) == 15
    assert times == sorted(set(times))


def test_run_prints_records_and_ends(clock: Clock, tmp_path: Path, receiver: Receiver) -> None:
    """Print frame rates once a second, record what is sent, and stop after the duration."""

    def tracker():
        number = 0
        while True:
            number += 1
            clock.turn(10)
            yield sighting([frame_at(clock.now, at=(1e-4 * number, 0.2, 0.0))])

    output = io.StringIO()
    recorder = Recorder(tmp_path / "hands.jsonl")
    sender = Sender(receiver.address[1], clock=clock)
    sent = run(tracker(), sender, recorder=recorder, duration=2.5, output=output, clock=clock)
    sender.close()
    recorder.close()
    assert sent == 2 * 250
    assert output.getvalue().splitlines() == ["left not seen, right 100/s"] * 2
    entries = read_recording(tmp_path / "hands.jsonl")
    assert entries[-1].time == 249 * 10 * MILLISECOND


def test_error_of_a_tracker_ends_the_run(receiver: Receiver) -> None:
    """Pass on the tracker's error."""

    def tracker():
        yield sighting([])
        raise TrackingError("unplugged")

    sender = Sender(receiver.address[1])
    with pytest.raises(TrackingError, match="unplugged"):
        run(tracker(), sender, output=io.StringIO())
    sender.close()


def test_tracker_clock_is_converted_by_the_smallest_delay(clock: Clock) -> None:
    """Convert times regardless of each frame's delay, and follow a clock that is set back."""
    mapped = ClockMap(clock)
    there = 5_000 * MILLISECOND
    offset = clock.now - there
    errors = []
    for delay in (4, 9, 1, 30, 2, 1):
        there += 10 * MILLISECOND
        clock.now = there + offset + delay * MILLISECOND
        errors.append(mapped(there) - (there + offset))
    # After the first frame with the smallest delay, the error is that delay.
    assert errors[2:] == pytest.approx([1e6] * 4, abs=2e4)
    clock.turn(2000)
    assert mapped(0) == clock.now
