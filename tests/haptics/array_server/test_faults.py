# SPDX-License-Identifier: GPL-3.0-or-later
"""An array without a watchdog is silenced whatever happens to the client, server or wire."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tactile_clay.haptics import ArrayClient
from tactile_clay.tests.haptics.peers.harness import (
    OFF_WITHIN,
    PATIENCE,
    TWO_FOCI,
    Peer,
    check_lateness,
    keep_sending,
    lateness,
    peer,
)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a pty is needed")


@pytest.fixture(params=["stock", "tactile"])
def board(request: pytest.FixtureRequest) -> Iterator[Peer]:
    """A SonicSurface, with either firmware."""
    with peer("sonicsurface_peer", request.param, "1") as started:
        started.firmware = request.param  # type: ignore[attr-defined]
        yield started


@pytest.fixture
def stock() -> Iterator[Peer]:
    """A SonicSurface that sounds after power-up."""
    with peer("sonicsurface_peer", "stock", "1") as started:
        started.firmware = "stock"  # type: ignore[attr-defined]
        yield started


def name_of(board: Peer, port: str = "") -> str:
    """The device name of the board."""
    firmware = board.firmware  # type: ignore[attr-defined]
    return f"sonicsurface:{port or board.first['port']},firmware={firmware}"


def sound(out: ArrayClient, board: Peer) -> None:
    """Send until the board emits what was sent."""
    keep_sending(out, TWO_FOCI, lambda: out.status().frames_per_second > 3, "frames")
    keep_sending(out, TWO_FOCI, lambda: board.ask("state")["sounds"], "sound")


def has_silent_half(state: dict[str, Any]) -> bool:
    """Whether one of the two patterns is silence."""
    return {32} in (set(state["pattern"]), set(state["hidden"]))


@pytest.mark.parametrize(
    ("end", "limit"),
    [
        pytest.param(lambda out: None, OFF_WITHIN, id="data stop"),
        pytest.param(lambda out: out.silence(), OFF_WITHIN, id="no foci"),
        pytest.param(lambda out: out.close(), OFF_WITHIN, id="close"),
        pytest.param(lambda out: out.process.send_signal(signal.SIGTERM), OFF_WITHIN, id="SIGTERM"),
        pytest.param(lambda out: out.process.send_signal(signal.SIGINT), OFF_WITHIN, id="SIGINT"),
        pytest.param(lambda out: out.process.stdin.close(), OFF_WITHIN, id="lost client"),
        # The guard must open the port first.
        pytest.param(lambda out: out.process.kill(), 0.5, id="SIGKILL"),
        # The guard also needs a second to notice.
        pytest.param(lambda out: out.process.send_signal(signal.SIGSTOP), 1.6, id="SIGSTOP"),
    ],
)
def test_sound_ends(stock: Peer, end: Callable[[ArrayClient], None], limit: float) -> None:
    """Be silent within 250 ms of the last data or a signal, and soon after the server is killed."""

    def attempt() -> float:
        with ArrayClient.start(name_of(stock)) as out:
            sound(out, stock)
            since = time.monotonic()
            end(out)
            return lateness(stock, since)

    check_lateness(attempt, limit)


def test_sound_ends_when_the_client_is_killed(board: Peer) -> None:
    """Be silent within 250 ms of a SIGKILL of the sending process, and end the server."""

    def attempt() -> float:
        client = Peer("lonely_client", name_of(board))
        begun = board.ask("state")["swaps"]
        board.wait(lambda state: state["sounds"] and state["swaps"] > begun + 20, "sound")
        since = time.monotonic()
        client.process.kill()
        late = lateness(board, since)
        client.close()
        end = time.monotonic() + PATIENCE
        while Path(f"/proc/{client.first['server']}").exists() and time.monotonic() < end:
            time.sleep(0.02)
        assert not Path(f"/proc/{client.first['server']}").exists()
        return late

    check_lateness(attempt)


def test_a_board_that_reboots_is_silenced(stock: Peer) -> None:
    """Silence a board within 250 ms if it sounds after power-up and nothing is sent."""
    with ArrayClient.start(name_of(stock)):
        stock.wait(lambda state: not state["sounds"], "silence")
        check_lateness(lambda: lateness(stock, stock.ask("reboot")["time"]))


def test_a_board_that_reboots_while_sounding_gets_its_silent_pattern_back(stock: Peer) -> None:
    """Rewrite the silent pattern between two bursts, which a reboot has replaced with sound."""
    with ArrayClient.start(name_of(stock)) as out:
        sound(out, stock)
        stock.ask("reboot")
        keep_sending(
            out,
            TWO_FOCI,
            lambda: has_silent_half(stock.ask("state")),
            "silence between bursts",
        )
        lateness(stock, time.monotonic())


def test_unplugging_is_survived(stock: Peer, tmp_path: Path) -> None:
    """Report a lost port, keep running, and silence the array when it is plugged in again."""
    link = tmp_path / "port"
    link.symlink_to(stock.first["port"])
    with ArrayClient.start(name_of(stock, str(link))) as out:
        sound(out, stock)
        stock.ask("hangup")
        keep_sending(out, TWO_FOCI, lambda: not out.status().connected, "a lost port")
        assert "port" in out.status().fault
        assert out.status().emitting
        link.unlink()
        link.symlink_to(stock.ask("replug")["port"])
        stock.wait(lambda state: not state["sounds"], "silence")
        assert out.status(wait=0.5).losses > 0
        sound(out, stock)


def test_a_port_that_stalls_is_abandoned(stock: Peer) -> None:
    """Abandon a port that accepts no data, and leave no sound in its buffers for later."""
    with ArrayClient.start(name_of(stock)) as out:
        sound(out, stock)
        stock.ask("stall")
        keep_sending(out, TWO_FOCI, lambda: out.status().losses > 0, "a write timeout")
        assert "accepts no data" in out.status().fault
        time.sleep(0.3)
        check_lateness(lambda: lateness(stock, stock.ask("resume")["time"]))
        sound(out, stock)


def test_an_incomplete_frame_does_not_matter(stock: Peer) -> None:
    """Silence a board that stopped in the middle of a frame, with another board selected."""
    port = os.open(stock.first["port"], os.O_WRONLY | os.O_NOCTTY)
    os.write(port, bytes([0xFE]) + bytes(100) + bytes([0xC1]))
    stock.wait(lambda state: state["read"] == 102, "half a frame")
    os.close(port)
    with ArrayClient.start(name_of(stock)) as out:
        state = stock.wait(lambda state: not state["sounds"], "silence")
        assert set(state["pattern"]) == {32}
        sound(out, stock)


def test_a_second_server_is_locked_out(stock: Peer) -> None:
    """Refuse to open a port that another process uses, and say so."""
    with ArrayClient.start(name_of(stock)) as out:
        sound(out, stock)
        with ArrayClient.start(name_of(stock)) as other:
            end = time.monotonic() + PATIENCE
            while not other.status(wait=0.2).fault and time.monotonic() < end:
                other.hello()
            assert "cannot be opened" in other.status().fault
            assert not other.status().connected


def test_the_guard_does_nothing_after_a_normal_end(stock: Peer) -> None:
    """Leave the port alone after the server has ended normally."""
    with ArrayClient.start(name_of(stock)) as out:
        sound(out, stock)
    lateness(stock, time.monotonic())
    read = stock.ask("state")["read"]
    time.sleep(0.3)
    assert stock.ask("state")["read"] == read
    listed = subprocess.run(["ps", "-ef"], capture_output=True, text=True, check=True).stdout
    assert f"guard {name_of(stock)}" not in listed


def test_a_guard_that_was_killed_is_replaced(stock: Peer) -> None:
    """Start another guard if the first is killed, and let it silence the array."""
    with ArrayClient.start(name_of(stock)) as out:
        sound(out, stock)
        assert out.process
        (first,) = children_of(out.process.pid)
        os.kill(first, signal.SIGKILL)
        server = out.process.pid
        keep_sending(out, TWO_FOCI, lambda: children_of(server) not in ([], [first]), "a new guard")
        out.process.kill()
        lateness(stock, time.monotonic())
        stock.wait(lambda state: set(state["hidden"]) == set(state["pattern"]) == {32}, "silence")


def children_of(parent: int) -> list[int]:
    """Running child processes of a process."""
    table = subprocess.run(
        ["ps", "-eo", "pid=,ppid=,stat="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split() for line in table.splitlines()]
    return [int(row[0]) for row in rows if int(row[1]) == parent and row[2][0] != "Z"]
