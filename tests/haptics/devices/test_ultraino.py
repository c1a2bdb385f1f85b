# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultraino: emulators of its three boards end up with the requested sound."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile_clay.haptics import ArrayClient, TransducerArray
from tactile_clay.haptics.devices import DeviceError, make_device
from tactile_clay.tests.haptics.peers.harness import (
    PlainFoci,
    foci,
    keep_sending,
    peer,
    pressures_at,
)

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="a pty is needed")

NEAR = foci((0.0, 0.0, 0.1, 400.0), (0.02, 0.02, 0.1, 240.0))
FAR = foci((0.0, 0.0, 0.15, 900.0), (0.03, 0.02, 0.14, 500.0))
TWO_MEGAS = """
[array]
p0 = 2.53
radius = 0.0045
phase_steps = 10
amplitude_steps = 1
working_volume = [[-0.1, -0.1, 0.04], [0.1, 0.1, 0.2]]
[grid]
columns = 16
rows = 8
pitch = 0.0105
"""


def fpga_drive(state: dict[str, Any], divisions: int) -> NDArray[np.complex128]:
    """The drive of an FPGA's current pattern of delays and pulse widths."""
    phases = np.array(state["phases"])
    on = phases < divisions
    loudness = np.sin(np.pi * np.array(state["widths"]) / divisions)
    return np.where(on, loudness * np.exp(2j * np.pi * phases / divisions), 0.0)


# Pins of the Mega for the outputs of the shield, by port (A C L B K F H D G J) and bit.
PINS = [
    *(
        51,
        52,
        53,
        54,
        28,
        29,
        30,
        31,
        47,
        46,
        45,
        44,
        43,
        42,
        41,
        40,
        56,
        57,
        58,
        59,
        48,
        49,
        72,
        69,
    ),
    *(39, 38, 37, 36, 35, 34, 33, 32, 21, 23, 65, 63, 9, 11, 13, 15, 20, 22, 64, 66, 8, 10, 12, 14),
    *(24, 25, 26, 27, 16, 17, 18, 19, 7, 6, 5, 4, 3, 2, 1, 0),
]


def mega_drive(wave: str) -> NDArray[np.complex128]:
    """Fundamental of each output's square wave, relative to that with a duty cycle of one half."""
    table = np.frombuffer(bytes.fromhex(wave), np.uint8).reshape(10, 10)
    bits = np.unpackbits(table[:, :, None], axis=2, bitorder="little").reshape(10, 80)
    # A delay of d divisions is the phase 2π d / 10, measured at the center of the pulse.
    turns = np.exp(2j * np.pi * np.arange(10) / 10)
    reference = turns[:5].sum()
    return (turns @ bits / reference)[PINS]


def check(array: TransducerArray, drive: NDArray[np.complex128], points: PlainFoci) -> None:
    """Check the pressures with the tolerance that so few phases allow."""
    ratio = pressures_at(array, drive, points.positions) / points.pressures
    assert ratio == pytest.approx(1.0, abs=0.15)


@needs_pty
@pytest.mark.parametrize(
    ("board", "divisions", "preset", "points"),
    [("fpga", 32, "sonicsurface", FAR), ("fpga128", 128, "ultraino", NEAR)],
)
def test_an_fpga_produces_the_requested_pressures(
    board: str, divisions: int, preset: str, points: PlainFoci
) -> None:
    """Reach the targets at two foci after any earlier pulse widths, then be silent."""
    with peer("ultraino_peer", board, "1") as emulator:
        states: list[dict[str, Any]] = []
        with ArrayClient.start(f"ultraino:{emulator.first['port']},board={board}") as out:

            def settled() -> bool:
                states.append(emulator.ask("state"))
                return states[-1]["sounds"] and states[-1]["exchanges"] > 40

            keep_sending(out, points, settled, "sound")
        array = TransducerArray.preset(preset)
        check(array, fpga_drive(states[-1], divisions)[: array.count], points)
        state = emulator.wait(lambda state: set(state["hidden"]) == {divisions}, "silence in both")
        assert not state["sounds"]


@needs_pty
@pytest.mark.parametrize("boards", [1, 2])
def test_a_mega_modulates_at_200_hz_by_itself(boards: int, tmp_path: Path) -> None:
    """Alternate 2.5 ms each of the requested pressures and of silence, then be silent."""
    path = tmp_path / "wide.toml"
    path.write_text(TWO_MEGAS, encoding="utf-8")
    array = TransducerArray.preset("ultraino") if boards == 1 else TransducerArray.from_toml(path)
    chosen = "" if boards == 1 else f",boards=2,array={path}"
    with peer("ultraino_peer", "mega", str(boards)) as emulator:
        assert emulator.ask("state")["sounds"]
        states: list[dict[str, Any]] = []
        with ArrayClient.start(f"ultraino:{emulator.first['port']}{chosen}") as out:
            emulator.wait(lambda state: not state["sounds"], "silence")

            def settled() -> bool:
                states.append(emulator.ask("state"))
                return states[-1]["sounds"] and states[-1]["exchanges"] > 20

            keep_sending(out, NEAR, settled, "sound")
            assert out.status(wait=0.5).frames_per_second > 0
        drives = []
        for (long, wave), (pause, rest) in states[-1]["waveforms"]:
            assert (long, pause) == (100, 100)
            assert set(rest) == {"0"}
            drives.append(mega_drive(wave))
        drive = np.concatenate(drives)[: array.count]
        assert set(np.round(np.abs(drive), 6)) <= {0.0, 1.0}
        check(replace(array, phase_steps=10), drive, NEAR)
        emulator.wait(lambda state: not state["sounds"], "silence")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ultraino:x,board=nano", "board must be mega or fpga or fpga128"),
        ("ultraino:x,board=fpga,boards=2", "Leave out boards"),
        ("ultraino:x,boards=15", "1 to 14 boards"),
        ("ultraino:x,boards=nan", "boards must be a number"),
        ("ultraino:x,array=sonicsurface", "64 outputs, too few for the 256"),
        ("ultraino:x,array=/no/such.toml", "/no/such.toml cannot be used"),
    ],
)
def test_wrong_options_are_named(name: str, said: str) -> None:
    """Say what is wrong with a name before anything is opened."""
    with pytest.raises(DeviceError, match=said):
        make_device(name)
