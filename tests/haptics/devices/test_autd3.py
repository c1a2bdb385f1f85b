# SPDX-License-Identifier: GPL-3.0-or-later
"""AUTD3 with its makers' emulators of the device (over UDP) and of its sound.

Skipped without its packages, which `make array-peers` installs in a separate environment.
"""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tactile_clay.haptics import ArrayClient, solve_drive
from tactile_clay.haptics.devices import DeviceError, Emission, make_device
from tactile_clay.tests.haptics.peers.autd3_environment import find_packages
from tactile_clay.tests.haptics.peers.harness import (
    PATIENCE,
    Peer,
    foci,
    keep_sending,
    peer,
    pressures_at,
)

# Searched for before any test imports them.
PACKAGES = find_packages()
POINTS = foci((0.0, 0.0, 0.15, 1500.0), (0.03, 0.02, 0.16, 900.0), (-0.03, 0.01, 0.14, 600.0))


@pytest.fixture
def emulator(monkeypatch: pytest.MonkeyPatch) -> Iterator[Peer]:
    """The emulator of the device, with the packages importable."""
    if PACKAGES is None:
        pytest.skip("AUTD3's packages are not installed: run `make array-peers`")
    monkeypatch.setattr(sys, "path", [*sys.path, PACKAGES])
    with peer("autd3_peer", PACKAGES) as started:
        yield started


@pytest.fixture
def device(emulator: Peer) -> Iterator[Any]:
    """A device connected to the emulator."""
    connected = make_device(f"autd3:{emulator.first['port']}")
    connected.open(time.monotonic())
    yield connected
    connected.close(time.monotonic())


def emission(device: Any, *, modulated: bool) -> Emission:
    """An emission at `POINTS`."""
    drive = solve_drive(device.array, POINTS.positions, POINTS.pressures)
    return Emission(
        POINTS.positions.astype(np.float32),
        POINTS.pressures.astype(np.float32),
        drive,
        modulated=modulated,
    )


def sound_of(*commands: Any) -> np.ndarray:
    """Root mean square pressure at `POINTS` according to autd3-emulator [Pa], shape [K]."""
    from autd3 import commands as all_commands
    from autd3_core import Autd3, Duration, Geometry
    from autd3_emulator import Emulator, Grid, RmsRecordOption

    geometry = Geometry([Autd3()])
    places = np.asarray(geometry[0].positions(), np.float64)
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))

    def play(recorder: Any) -> None:
        recorder.send(all_commands.SetSilencer.disable())
        for command in commands:
            recorder.send(command)
        recorder.tick(Duration.from_millis(3))

    record = Emulator(geometry).record(play)
    found = []
    for place in middle + 1e3 * POINTS.positions:
        grid = Grid(*map(float, place), 1.0, "xyz")
        table = record.sound_field(grid, RmsRecordOption()).next(Duration.from_millis(3))
        found.append(float(table.to_numpy()[0, -1]))
    return np.array(found)


def test_its_own_sound_field_has_the_requested_proportions(device: Any) -> None:
    """Reach the requested ratios of pressures at three foci within 3 % in autd3-emulator."""
    wanted = emission(device, modulated=False)
    device.emit(wanted, time.monotonic())
    heard = sound_of(device._pattern)
    ratio = heard / POINTS.pressures
    assert ratio / ratio.mean() == pytest.approx(1.0, abs=0.03)
    own = pressures_at(device.array, device.held, POINTS.positions)
    assert own / POINTS.pressures == pytest.approx(1.0, abs=0.03)
    # The emulator's transducer is no piston, so the pressures differ by a common factor.
    factor = heard * np.sqrt(2.0) / own
    assert factor / factor.mean() == pytest.approx(1.0, abs=0.05)


def test_silence_is_silent_by_its_own_emulator(device: Any) -> None:
    """Emit nothing after `off` and after connecting."""
    assert sound_of(device._pattern) == pytest.approx(0.0, abs=1e-3)
    device.emit(emission(device, modulated=True), time.monotonic())
    device.off(time.monotonic())
    assert sound_of(device._pattern) == pytest.approx(0.0, abs=1e-3)


def test_the_device_modulates_at_200_hz(device: Any) -> None:
    """Send one period of 20 samples at 4 kHz, from silence to full and back."""
    from autd3_core import Autd3, Duration, Geometry
    from autd3_emulator import Emulator

    def play(recorder: Any) -> None:
        recorder.send(device._modulation(modulated=True))
        device.emit(emission(device, modulated=True), time.monotonic())
        recorder.send(device._pattern)
        recorder.tick(Duration.from_millis(25))

    widths = Emulator(Geometry([Autd3()])).record(play).pulse_width().to_numpy()
    loudest = widths[np.argmax(widths.max(axis=1))].astype(float)[200:]
    spectrum = np.abs(np.fft.rfft(loudest - loudest.mean()))
    frequency = np.fft.rfftfreq(len(loudest), 1 / 40e3)[np.argmax(spectrum)]
    assert frequency == pytest.approx(200.0, abs=45.0)
    assert loudest.min() < 0.1 * loudest.max()


def test_the_watchdog_is_triggered_when_the_loop_hangs_and_released_after(device: Any) -> None:
    """Let the device silence itself while nothing is sent, and resume afterward."""
    device.emit(emission(device, modulated=True), time.monotonic())
    end = time.monotonic() + PATIENCE
    states: list[Any] = []
    while not (states and states[-1].is_failsafe_active()) and time.monotonic() < end:
        time.sleep(0.4)
        (state,) = device._run(device._client.read_fpga_state)
        states.append(state)
    assert states[-1].is_failsafe_active()
    device.service(time.monotonic())
    (state,) = device._run(device._client.read_fpga_state)
    assert not state.is_failsafe_active()


def test_a_server_drives_it_and_survives_its_reboot(emulator: Peer) -> None:
    """Send frames over UDP, report when the device is gone, and reconnect to it."""
    with ArrayClient.start(f"autd3:{emulator.first['port']}") as out:
        keep_sending(out, POINTS, lambda: out.status().frames_per_second > 20, "frames")
        keep_sending(out, POINTS, lambda: out.status().foci == 3, "focal points")
        keep_sending(out, POINTS, lambda: np.abs(out.drive()).max() > 0.1, "a drive")
        emulator.ask("reboot")
        keep_sending(out, POINTS, lambda: out.status().losses > 0, "a lost device")
        keep_sending(out, POINTS, lambda: "AUTD3" in out.status().fault, "a reason")
        keep_sending(out, POINTS, lambda: out.status().connected, "a new beginning")
        keep_sending(out, POINTS, lambda: out.status().emitting, "sound")
        end = time.monotonic() + PATIENCE
        while out.status(wait=0.1).emitting and time.monotonic() < end:
            pass
        assert not out.status().emitting


def test_missing_packages_are_named() -> None:
    """Say which packages of a device are missing."""
    if PACKAGES == "":
        pytest.skip("AUTD3's packages are in this environment")
    hidden = {name: sys.modules.pop(name) for name in list(sys.modules) if name.startswith("autd3")}
    try:
        with pytest.raises(DeviceError, match=r"autd3-pattern and autd3-modulation, version 0\.12"):
            make_device("autd3")
    finally:
        with contextlib.suppress(KeyError):
            sys.modules.update(hidden)
