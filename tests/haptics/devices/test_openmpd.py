# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenMPD: a simulated board behind a pyusb backend ends up with the requested sound."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactile_clay.haptics import ArrayClient, TransducerArray
from tactile_clay.haptics.devices import DeviceError, make_device
from tactile_clay.tests.haptics.peers.harness import (
    OFF_WITHIN,
    PATIENCE,
    TWO_FOCI,
    Peer,
    check_lateness,
    keep_sending,
    lateness,
    peer,
    pressures_at,
)


def board_text(seed: int = 1) -> str:
    """A board file with shuffled pins and a phase correction for each transducer."""
    random = np.random.default_rng(seed)
    places = TransducerArray.preset("openmpd").positions
    rows = ["".join(f"({x:.6f}, {y:.6f}, {z:.6f})," for x, y, z in places)]
    for values in (random.permutation(256), random.integers(0, 360, 256)):
        rows.append("".join(f"{value}," for value in values))
    rows.append("1.000000," * 256)
    return "\n".join(("FT6PLAY1", "256", "128", *rows)) + "\n"


@pytest.fixture
def board_file(tmp_path: Path) -> Path:
    """A board file on disk."""
    path = tmp_path / "board_7.pat"
    path.write_text(board_text(), encoding="utf-8")
    return path


@contextmanager
def serving(board: Peer, path: Path) -> Iterator[ArrayClient]:
    """The client of an array server whose USB is connected to a board in another process."""
    module = "tactile_clay.tests.haptics.peers.openmpd_server"
    words = [str(board.first["port"]), f"openmpd:{path}", "--for-client"]
    process = subprocess.Popen(
        [sys.executable, "-m", module, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout
    said = json.loads(process.stdout.readline())
    client = ArrayClient(said["port"], session=said["session"])
    client.process = process
    client.hello()
    with client:
        yield client


def test_the_board_produces_the_requested_pressures(board_file: Path) -> None:
    """Reach the targets within 5 % through pins, corrections and pulse widths, at 200 Hz."""
    lines = board_text().splitlines()
    pins = np.array([int(part) for part in lines[4].split(",") if part])
    adjust = np.radians([float(part) for part in lines[5].split(",") if part])
    with peer("openmpd_board") as board, serving(board, board_file) as out:
        assert board.wait(lambda state: not state["sounds"], "silence")["messages"] > 0
        keep_sending(out, TWO_FOCI, lambda: board.ask("state")["messages"] > 200, "sound")
        keep_sending(out, TWO_FOCI, lambda: out.status().foci == 2, "two focal points")
        state = board.ask("state")
    widths = np.array(state["loudest"]["widths"])[pins]
    begins = np.array(state["loudest"]["phases"])[pins]
    # The center of a pulse that starts at p and lasts w, relative to that of half a period.
    phases = 2.0 * np.pi * (begins + widths / 2.0 - 32.0) / 128.0
    drive = np.sin(0.5 * np.pi * widths / 64.0) * np.exp(1j * (phases + adjust))
    array = TransducerArray.preset("openmpd")
    ratio = pressures_at(array, drive, TWO_FOCI.positions) / TWO_FOCI.pressures
    assert ratio == pytest.approx(1.0, abs=0.05)
    # Reset, a latency of 2 ms, and both purges, on the chip's first port.
    assert [0x40, 9, 2, 1] in state["controls"]
    assert [0x40, 0, 2, 1] in state["controls"]
    ups = [when for when, sounds in state["changes"] if sounds]
    assert np.median(np.diff(ups)) == pytest.approx(0.005, rel=0.25)


@pytest.mark.parametrize(
    ("end", "limit"), [(signal.SIGTERM, OFF_WITHIN), (None, OFF_WITHIN), (signal.SIGKILL, 0.5)]
)
def test_sound_ends(board_file: Path, end: signal.Signals | None, limit: float) -> None:
    """Be silent within 250 ms of the last data or a signal, and soon after the server is killed."""
    with peer("openmpd_board") as board:

        def attempt() -> float:
            with serving(board, board_file) as out:
                sounds = board.ask("state")["messages"] + 60
                keep_sending(out, TWO_FOCI, lambda: board.ask("state")["messages"] > sounds, "it")
                since = time.monotonic()
                if end is not None:
                    assert out.process
                    out.process.send_signal(end)
                return lateness(board, since)

        check_lateness(attempt, limit)


def test_unplugging_and_stalling_are_survived(board_file: Path) -> None:
    """Report what is wrong with the chip, keep running, and start again with silence."""
    with peer("openmpd_board") as board, serving(board, board_file) as out:
        keep_sending(out, TWO_FOCI, lambda: board.ask("state")["messages"] > 60, "sound")
        board.ask("stall")
        keep_sending(out, TWO_FOCI, lambda: out.status().losses > 0, "a timeout")
        assert "accepts no data" in out.status().fault
        board.ask("resume")
        keep_sending(out, TWO_FOCI, lambda: out.status().connected, "a new beginning")
        board.ask("unplug")
        keep_sending(
            out, TWO_FOCI, lambda: "no FTDI chip" in out.status().fault, "an unplugged chip"
        )
        since = board.ask("plug")["time"]
        end = time.monotonic() + PATIENCE
        while not out.status(wait=0.1).connected and time.monotonic() < end:
            out.hello()
        board.wait(lambda state: not state["sounds"] and state["time"] > since, "silence")
        check_lateness(lambda: lateness(board, board.ask("reboot")["time"]))


def change(text: str, line: int, new: str) -> str:
    """The text with one line replaced."""
    lines = text.splitlines()
    lines[line] = new
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has 0 lines"),
        (change(board_text(), 1, "64"), "64 transducers, not 256"),
        (change(board_text(), 2, "32"), "32 phases, not 128"),
        (change(board_text(), 3, "(1,2,3),"), "1 positions"),
        (change(board_text(), 4, "0," * 256), "pins must be the numbers"),
        (change(board_text(), 5, "x," * 256), "is not a number"),
        (change(board_text(), 6, "1.5," * 256), "must be from 0 to 1"),
    ],
)
def test_a_damaged_board_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    """Say what is wrong with a board file before anything is opened."""
    path = tmp_path / "board.pat"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DeviceError, match=said):
        make_device(f"openmpd:{path}")


def test_a_missing_board_file_is_named() -> None:
    """Ask for the board file if none is given, and name one that does not exist."""
    with pytest.raises(DeviceError, match=r"board_N\.pat"):
        make_device("openmpd")
    with pytest.raises(DeviceError, match="cannot be read"):
        make_device("openmpd:/no/such/file.pat")


def test_narrow_pulses_keep_their_center(board_file: Path) -> None:
    """Delay a pulse by half of the amount by which it is narrower."""
    device: Any = make_device(f"openmpd:{board_file}")
    flat = replace(device.array, phase_offsets=np.zeros(256))
    assert flat.count == 256
    full = np.frombuffer(device.message(np.ones(256, complex)), np.uint8)
    half = np.frombuffer(device.message(np.full(256, np.sin(np.pi / 4), complex)), np.uint8)
    assert set(full[256:]) == {64}
    assert set(half[256:]) == {32}
    assert set((half[:256] & 127).astype(int) - (full[:256] & 127)) == {16}
    assert full[0] & 128
    assert (full[1:256] < 128).all()
