# SPDX-License-Identifier: GPL-3.0-or-later
"""SonicSurface: an emulator of its protocol ends up with the requested sound."""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile_clay.haptics import ArrayClient, TransducerArray
from tactile_clay.haptics.devices import DeviceError, make_device
from tactile_clay.tests.haptics.peers.harness import TWO_FOCI, keep_sending, peer, pressures_at

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="a pty is needed")

CASES = (("stock", 1), ("stock", 2), ("tactile", 1))


def surface() -> TransducerArray:
    """The array in the order of the board's bytes, by the formula in its own source files.

    There, columns follow increasing x and rows decreasing z, and +y points out of the array. A
    rotation about x takes +y to +z here, and decreasing z to increasing y.
    """
    places = np.zeros((256, 3))
    for column in range(16):
        for row in range(16):
            index = (
                64 * (column // 4)
                + 8 * (row // 2)
                + [[0, 7, 1, 2], [4, 3, 6, 5]][row % 2][column % 4]
            )
            x, z = (column - 7.5) * 0.0105, (7.5 - row) * 0.0105
            places[index] = (x, -z, 0.0)
    return replace(
        TransducerArray.preset("sonicsurface"), positions=places, phase_offsets=np.zeros(256)
    )


def emitted(pattern: list[int]) -> NDArray[np.complex128]:
    """The drive of a pattern of delays in 32nds of a period, where 32 is off."""
    phases = np.array(pattern)
    return np.where(phases == 32, 0.0, np.exp(2j * np.pi * phases / 32.0))


@needs_pty
@pytest.mark.parametrize(("firmware", "boards"), CASES)
def test_the_emulator_produces_the_requested_pressures(firmware: str, boards: int) -> None:
    """Reach the targets at two foci within 10 %, through bytes at the speed of the wire."""
    with peer("sonicsurface_peer", firmware, str(boards)) as board:
        name = f"sonicsurface:{board.first['port']},firmware={firmware},boards={boards}"
        with ArrayClient.start(name) as out:
            states: list[dict[str, Any]] = []

            def settled() -> bool:
                states.append(board.ask("state"))
                said = out.status()
                sounds = states[-1]["sounds"] and states[-1]["swaps"] > 40
                return bool(sounds and said.connected and said.foci == 2)

            keep_sending(out, TWO_FOCI, settled, "sound")
        sound = emitted(states[-1]["pattern"])
        ratio = pressures_at(surface(), sound, TWO_FOCI.positions) / TWO_FOCI.pressures
        assert ratio == pytest.approx(1.0, abs=0.1)
        board.wait(lambda state: not state["sounds"], "silence")
        board.wait(lambda state: set(state["hidden"]) == {32}, "silence in the other pattern")
        if firmware == "tactile":
            assert states[-1]["modulation"] == pytest.approx(208.3, abs=0.1)


@needs_pty
def test_connecting_silences_a_board_that_powers_up_with_sound() -> None:
    """Write silence to both patterns before any focal point arrives."""
    with peer("sonicsurface_peer", "stock", "1") as board:
        assert board.ask("state")["sounds"]
        with ArrayClient.start(f"sonicsurface:{board.first['port']}"):
            state = board.wait(lambda state: not state["sounds"], "silence")
            board.wait(lambda state: set(state["hidden"]) == {32}, "silence in the other pattern")
        assert set(state["pattern"]) == {32}


def test_stock_firmware_is_modulated_at_200_hz_by_the_serial_clock() -> None:
    """Exchange sound and silence 400 times a second between uploads, and end each in silence."""
    device = make_device("sonicsurface:loop://")
    period = device._period  # type: ignore[attr-defined]
    assert period.count(0xFD) == 2
    assert len(period) * 10 / 230400 == pytest.approx(1 / 200, rel=0.005)
    assert set(period) == {0xFD, 0xC0}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sonicsurface:/dev/null,firmware=nice", "firmware must be stock or tactile"),
        ("sonicsurface:/dev/null,speed=1", "no option 'speed'"),
        ("sonicsurface:/dev/null,firmware=tactile,boards=2", "only one board"),
    ],
)
def test_wrong_options_are_named(name: str, said: str) -> None:
    """Say what is wrong with a name before anything is opened."""
    with pytest.raises(DeviceError, match=said):
        make_device(name)


def test_a_missing_port_is_named() -> None:
    """Say which port cannot be opened, and what to check."""
    device = make_device("sonicsurface:/dev/no-such-port")
    with pytest.raises(DeviceError, match=r"/dev/no-such-port cannot be opened.*--list"):
        device.open(0.0)
