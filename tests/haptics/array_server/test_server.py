# SPDX-License-Identifier: GPL-3.0-or-later
"""The server's rules, with a simulated clock: only recent, valid, capped foci are emitted."""

import random
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tactile_clay.haptics import TransducerArray, acoustic_field
from tactile_clay.haptics.array_server import server as server_module
from tactile_clay.haptics.array_server.limits import STALE_AFTER, Limits, OnTime, cap_drive
from tactile_clay.haptics.protocol.datagram import Kind, encode
from tactile_clay.tests.haptics.array_server.recording_device import Bench

FOCUS = [(0.0, 0.0, 0.15, 800.0)]


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A server with a simulated clock."""
    started = Bench()
    started.server.step(0.0)
    yield started
    started.close()


def test_it_listens_on_loopback_only(bench: Bench) -> None:
    """Bind to 127.0.0.1, so that no other machine can reach an array."""
    assert bench.server._socket.getsockname()[0] == "127.0.0.1"


def test_sound_follows_focal_points_and_ends_with_them(bench: Bench) -> None:
    """Emit while focal points arrive, be silent 150 ms after the last, and report it."""
    for _ in range(10):
        bench.send(FOCUS)
        bench.pass_time(0.016, 0.016)
    assert bench.device.sounds
    bench.pass_time(STALE_AFTER - 0.03)
    assert bench.device.sounds
    bench.pass_time(0.03)
    assert not bench.device.sounds
    assert not bench.server.status(bench.now)["emitting"]


@pytest.mark.parametrize(
    "rows", [[], [(0.0, 0.0, 0.15, 0.0)], [(0.0, 0.0, 5.0, 900.0)]], ids=["none", "0 Pa", "outside"]
)
def test_silence_is_obeyed_immediately(bench: Bench, rows: list) -> None:
    """Be silent for no focal points, for 0 Pa and for focal points outside the working volume."""
    bench.send(FOCUS)
    assert bench.device.sounds
    bench.send(rows)
    assert not bench.device.sounds


@pytest.mark.parametrize("jump", [0.2, 10.0, 1e6, -0.006, -10.0, -900.0])
def test_a_clock_that_jumps_ends_sound(bench: Bench, jump: float) -> None:
    """Be silent immediately when the clock jumps, and continue with datagrams recent by it."""
    bench.send(FOCUS)
    assert bench.device.sounds
    bench.now += jump
    bench.server.step(0.0)
    assert not bench.device.sounds
    bench.send(FOCUS)
    assert bench.device.sounds


def test_the_wall_clock_is_not_used(repository: Path) -> None:
    """Use only the monotonic clock, because users may set the wall clock while there is sound."""
    for folder in ("array_server", "devices"):
        for path in (repository / "haptics" / folder).rglob("*.py"):
            assert not re.search(r"time\.time\(|datetime\.|time\.time_ns", path.read_text("utf-8"))


@pytest.mark.parametrize(
    "changes",
    [
        {"time": 1000.0 - 0.16},
        {"time": 1000.0 + 0.02},
        {"session": 78},
        {"sequence": 0},
    ],
    ids=["old", "from the future", "another session", "out of order"],
)
def test_datagrams_with_a_wrong_time_or_session_are_refused(bench: Bench, changes: dict) -> None:
    """Refuse datagrams that are old, early, of another session or out of order, and count them."""
    bench.send(FOCUS, time=999.99)
    bench.device.log.clear()
    bench.send([(0.01, 0.0, 0.15, 500.0)], **changes)
    assert "emit" not in bench.device.log
    assert sum(bench.server.status(bench.now)["refused"].values()) == 1


def test_a_busy_device_gets_only_the_newest(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drop focal points that newer ones have replaced, and count them."""
    monkeypatch.setattr(type(bench.device), "busy", lambda self, now: max(0.0, 1000.05 - now))
    for index in range(5):
        bench.send([(0.01 * index, 0.0, 0.15, 500.0)])
        bench.now += 0.005
    assert not bench.device.emissions
    bench.now = 1000.06
    bench.server.step(0.0)
    ((_, emission),) = bench.device.emissions
    assert emission.positions[0, 0] == pytest.approx(0.04)
    assert bench.server.status(bench.now)["dropped"] == 4


def test_the_strongest_of_too_many_focal_points_are_kept(bench: Bench) -> None:
    """Admit as many as the device supports, in the original order."""
    pressures = [100.0 + (17 * index) % 40 for index in range(40)]
    bench.send([(0.001 * index, 0.0, 0.15, p) for index, p in enumerate(pressures)])
    (_, emission) = bench.device.emissions[-1]
    kept = [p for p in pressures if p >= sorted(pressures)[-bench.device.maximum_foci]]
    assert emission.pressures.tolist() == kept


def test_caps_always_hold() -> None:
    """Lower pressures and amplitudes to the caps, for arrays with and without amplitude steps."""
    for preset in ("openmpd", "sonicsurface", "stratos_explore"):
        started = Bench(limits=Limits(amplitude=0.3, pressure=700.0), preset=preset)
        started.server.step(0.0)
        started.send([(0.0, 0.0, 0.12, 1e30), (0.02, 0.0, 0.12, 100.0)])
        (_, emission) = started.device.emissions[-1]
        assert emission.pressures.tolist() == [700.0, 100.0]
        amplitude = np.abs(emission.drive)
        loudness = amplitude.mean() if preset == "sonicsurface" else amplitude.max()
        assert 0.0 < loudness <= 0.3 + 1e-9
        field = np.abs(acoustic_field(started.device.array, emission.drive, emission.positions))
        assert field[0] <= 700.0 * 1.1
        started.close()


@pytest.mark.parametrize(
    "values", [(0.0, 1.0, 1.0), (1.1, 1.0, 1.0), (1.0, 2001.0, 1.0), (1.0, 1.0, 121.0)]
)
def test_caps_can_only_be_lowered(values: tuple[float, float, float]) -> None:
    """Refuse caps of 0 and above the built-in ones."""
    with pytest.raises(ValueError, match="at most"):
        Limits(*values)


@given(
    hnp.arrays(np.float64, 256, elements=st.floats(0.0, 1.0)),
    st.floats(0.01, 1.0),
    st.sampled_from(["openmpd", "sonicsurface", "stratos_explore"]),
)
@settings(max_examples=40)
def test_a_capped_drive_keeps_its_phases(amplitudes: np.ndarray, limit: float, preset: str) -> None:
    """Cap amplitudes or their mean without changing phases."""
    array = TransducerArray.preset(preset)
    phases = np.exp(1j * np.linspace(0.0, 50.0, 256))
    if preset == "sonicsurface":
        amplitudes = np.round(amplitudes)
    capped = cap_drive(array, amplitudes * phases, limit)
    size = np.abs(capped)
    assert (size.mean() if preset == "sonicsurface" else size.max()) <= limit + 1e-9
    assert np.allclose((capped / phases).imag, 0.0, atol=1e-9)
    assert (size <= amplitudes + 1e-9).all()


def test_sound_without_a_pause_is_limited() -> None:
    """Pause at the on-time limit although focal points continue; sound at most half the time."""
    started = Bench(limits=Limits(on_time=12.0), preset="ultraino")
    started.server.step(0.0)
    sounding = []
    for _ in range(1200):
        started.now += 0.1
        started.send(FOCUS)
        sounding.append(started.device.sounds)
    first = sounding.index(False, 1)
    assert first * 0.1 == pytest.approx(12.0, abs=0.3)
    assert sounding[first:].index(True) * 0.1 == pytest.approx(1.0, abs=0.3)
    assert np.mean(sounding[first:]) == pytest.approx(0.5, abs=0.05)
    started.close()


def test_on_time_is_restored_by_silence() -> None:
    """Restore a second of sound for each second of silence, up to the limit."""
    counter = OnTime(10.0)
    counter.advance(0.0, emitting=False)
    for second in range(1, 7):
        counter.advance(float(second), emitting=True)
    assert counter.left == pytest.approx(4.0)
    for second in range(7, 30):
        counter.advance(float(second), emitting=False)
    assert counter.left == 10.0
    counter.advance(20.0, emitting=True)
    assert counter.left == 10.0


def test_a_device_that_breaks_is_opened_again(bench: Bench) -> None:
    """Report the fault, keep trying, and start again with silence."""
    bench.send(FOCUS)
    bench.device.broken = True
    bench.send(FOCUS)
    status = bench.server.status(bench.now)
    assert (status["connected"], status["emitting"], status["losses"]) == (False, True, 1)
    assert status["fault"] == "It is broken."
    bench.device.broken = False
    bench.device.log.clear()
    bench.pass_time(0.3)
    assert bench.device.log[0] == "open"
    assert bench.server.status(bench.now)["connected"]
    assert not bench.device.sounds


def test_an_exception_ends_in_silence(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Silence the device if the loop fails with any exception."""

    def fail(*values: object) -> None:
        raise RuntimeError("broken")

    bench.send(FOCUS)
    assert bench.device.sounds
    monkeypatch.setattr(server_module, "solve_drive", fail)
    bench.now += 0.02
    bench.socket.sendto(
        encode(
            Kind.FOCI,
            session=77,
            sequence=99,
            time=bench.now,
            positions=np.array(((0.0, 0.0, 0.15),)),
            pressures=np.array((1.0,)),
        ),
        ("127.0.0.1", bench.server.port),
    )
    with pytest.raises(RuntimeError, match="broken"):
        bench.server.run()
    assert not bench.device.sounds


def check_emissions(bench: Bench) -> None:
    """Check that everything sent to the device is valid and capped."""
    array, limits = bench.device.array, bench.server.limits
    for _, emission in bench.device.emissions:
        assert 0 < len(emission.positions) <= bench.device.maximum_foci
        assert np.isfinite(emission.positions).all()
        assert array.reaches(emission.positions).all()
        assert (emission.pressures > 0.0).all()
        assert (emission.pressures <= limits.pressure).all()
        assert np.isfinite(emission.drive).all()
        # For transducers that are only on or off, the cap limits their number.
        assert np.abs(emission.drive).mean() <= limits.amplitude + 1e-9


numbers = st.one_of(
    st.floats(width=32, allow_nan=True, allow_infinity=True), st.floats(-0.25, 0.375, width=32)
)


@given(
    st.lists(
        st.tuples(
            hnp.arrays(np.float32, st.tuples(st.integers(0, 40), st.just(4)), elements=numbers),
            st.sampled_from([77, 77, 77, 0, 1]),
            st.integers(0, 20),
            st.one_of(st.just(0.0), st.floats(-1.0, 1.0)),
            st.sampled_from(Kind),
            st.integers(0, 3),
            st.floats(0.0, 0.3),
        ),
        max_size=8,
    )
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_nothing_but_valid_fresh_capped_foci_reaches_a_device(messages: list) -> None:
    """Send valid and corrupted datagrams with arbitrary numbers to the server."""
    bench = Bench(limits=Limits(amplitude=0.9, pressure=500.0), preset="ultraino")
    bench.server.step(0.0)
    fresh_until = -np.inf
    for rows, session, sequence, age, kind, turned, pause in messages:
        values = {"session": session, "sequence": sequence, "time": max(0.0, bench.now - age)}
        try:
            data = encode(
                kind,
                **values,
                **(
                    {"table": {}}
                    if kind in (Kind.STATUS, Kind.DRIVE)
                    else {"positions": rows[:, :3], "pressures": rows[:, 3]}
                ),
            )
        except ValueError:
            continue
        broken = bytearray(data)
        for _ in range(turned):
            broken[random.randrange(len(broken))] ^= 1 << random.randrange(8)
        count = len(bench.device.emissions)
        bench.send_bytes(bytes(broken))
        if len(bench.device.emissions) > count:
            assert session == 77
            assert kind is Kind.FOCI
            assert bytes(broken) == data
            assert -0.005 - 1e-6 <= age <= STALE_AFTER + 1e-6
            fresh_until = bench.now - age + STALE_AFTER
        bench.now += pause
        bench.server.step(0.0)
        assert not bench.device.sounds or bench.now <= fresh_until + 1e-6
    check_emissions(bench)
    bench.close()
    assert not bench.device.sounds


@given(st.lists(st.binary(max_size=200), max_size=20))
@settings(max_examples=40, deadline=None)
def test_random_bytes_never_sound(datagrams: list[bytes]) -> None:
    """Ignore arbitrary bytes."""
    bench = Bench()
    for data in datagrams:
        bench.send_bytes(data)
    assert bench.device.emissions == []
    bench.close()


def test_a_flood_does_not_block_the_loop(bench: Bench) -> None:
    """End sound in time while invalid datagrams arrive continuously."""
    bench.send(FOCUS)
    assert bench.device.sounds
    for _ in range(300):
        for _ in range(5):
            bench.socket.sendto(b"x" * 100, ("127.0.0.1", bench.server.port))
        bench.now += 0.001
        bench.server.step(0.0)
    assert not bench.device.sounds


def test_there_is_no_sound_without_a_running_guard() -> None:
    """Wait for the guard before the first sound, and be silent while it is being replaced."""
    started = Bench()
    guard: Any = SimpleNamespace(ready=False, beat=lambda emitting: None, end=lambda silent: None)
    started.server._guard = guard
    started.server.step(0.0)
    started.send(FOCUS)
    assert not started.device.sounds
    guard.ready = True
    started.send(FOCUS)
    assert started.device.sounds
    guard.ready = False
    started.send(FOCUS)
    assert not started.device.sounds
    started.close()
