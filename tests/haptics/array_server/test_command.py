# SPDX-License-Identifier: GPL-3.0-or-later
"""The command ``array-server``: its output and its errors."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from tactile_clay.clay_addon.command.line import main
from tactile_clay.haptics import ArrayClient
from tactile_clay.haptics.array_server import ArrayServerError, Limits, command
from tactile_clay.haptics.devices import DeviceError, FoundDevice, serial_port
from tactile_clay.tests.haptics.peers.harness import PATIENCE, TWO_FOCI, keep_sending


def test_connected_devices_are_listed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """List serial ports of USB adapters as devices, and say which kinds cannot be searched for."""

    adapter = SimpleNamespace(
        device="/dev/ttyUSB7", description="CH340", hwid="USB VID:PID=1A86:7523", vid=0x1A86
    )
    built_in = SimpleNamespace(device="/dev/ttyS0", description="ttyS0", hwid="PNP0501", vid=None)
    module = serial_port.load_pyserial()
    monkeypatch.setattr(module.tools.list_ports, "comports", lambda: [adapter, built_in])

    def no_library() -> list[FoundDevice]:
        raise DeviceError("The library libusb-1.0 is missing.")

    monkeypatch.setattr("tactile_clay.haptics.devices.openmpd.list_devices", no_library)
    assert main(["array-server", "--list"]) == 0
    said = capsys.readouterr()
    assert "sonicsurface:/dev/ttyUSB7" in said.out
    assert "ultraino:/dev/ttyUSB7" in said.out
    assert "ttyS0" not in said.out
    assert "libusb-1.0 is missing" in said.err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 2, "give a device"),
        (["theremin"], 2, "There is no device 'theremin'. There are: simulated, sonicsurface"),
        (["simulated:theremin"], 2, "no array preset 'theremin'"),
        (["simulated:a,b,c"], 2, "NAME:ADDRESS,KEY=VALUE"),
        (["simulated", "--amplitude-cap", "1.5"], 2, "amplitude cap must be above 0 and at most 1"),
        (["simulated", "--on-time", "900"], 2, "at most 120"),
        (["simulated", "--pressure-cap", "nan"], 2, "at most 2000"),
    ],
)
def test_wrong_arguments_are_explained(
    words: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refuse wrong arguments, and say what is possible."""
    assert main(["array-server", *words]) == code
    assert said in capsys.readouterr().err


def test_help_lists_devices_and_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    """List all devices, the exit codes and the safety limits."""
    assert main(["array-server", "--help"]) == 0
    said = capsys.readouterr().out
    for word in ("simulated", "sonicsurface", "ultraino", "openmpd", "autd3", "stratos_explore"):
        assert word in said
    assert "150 ms" in said
    assert "exit codes" in said


def has_foci(out: ArrayClient) -> bool:
    """Whether two focal points are being emitted."""
    return out.status().foci == 2


def start_by_hand(*words: str) -> subprocess.Popen[str]:
    """Run the command in a separate process, as users do."""
    code = "from tactile_clay.clay_addon.command.line import run; run()"
    return subprocess.Popen(
        [sys.executable, "-c", code, "array-server", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_a_server_started_by_hand_serves_any_client() -> None:
    """Print the port, serve one client after another, and end on Ctrl-C."""
    process = start_by_hand("simulated:openmpd", "--port", "0")
    assert process.stdout
    line = process.stdout.readline()
    assert line.startswith("simulated:openmpd: listening on 127.0.0.1:")
    port = int(line.rsplit(":", 1)[1])
    for _ in range(2):
        with ArrayClient(port) as out:
            keep_sending(out, TWO_FOCI, partial(has_foci, out), "sound")
    taken = start_by_hand("simulated", "--port", str(port))
    _, said = taken.communicate(timeout=PATIENCE)
    assert taken.returncode == 1
    assert f"cannot listen on port {port}" in said
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 0
    process.communicate()


def test_a_client_says_why_a_server_does_not_start() -> None:
    """Quote the server's output for an unknown device."""
    with pytest.raises(ArrayServerError, match="no device 'theremin'"):
        ArrayClient.start("theremin")


def test_a_clients_caps_reach_the_server() -> None:
    """Start a server with given limits, which it then obeys."""
    limits = Limits(pressure=300.0, amplitude=0.5, on_time=60.0)
    with ArrayClient.start("simulated:openmpd", limits=limits) as out:
        keep_sending(out, TWO_FOCI, lambda: bool(out.drive().any()), "sound")
        assert 0.0 < out.status(wait=0.5).on_time_left <= 60.0
        assert abs(out.drive()).max() <= 0.5


def test_a_client_without_a_server_knows() -> None:
    """Send without an error if nobody listens, and report it in the status."""
    with ArrayClient(9) as out:
        out.send(TWO_FOCI)
        out.send(TWO_FOCI)
        assert not out.status(wait=0.05).heard
        with pytest.raises(ArrayServerError, match="does not answer"):
            out.drive(wait=0.05)


def test_a_status_that_has_waited_is_out_of_date() -> None:
    """Count a server as lost if its last status arrived long before it was read."""
    process = start_by_hand("simulated", "--port", "0")
    assert process.stdout
    port = int(process.stdout.readline().rsplit(":", 1)[1])
    with ArrayClient(port) as out:
        out.hello()
        assert out.status(wait=PATIENCE).heard
        time.sleep(0.3)
        process.terminate()
        process.wait(PATIENCE)
        time.sleep(0.6)
        assert not out.status().heard
    process.communicate()


def test_the_guard_of_a_simulated_array_ends_with_it() -> None:
    """Leave no process running."""
    with ArrayClient.start("simulated") as out:
        keep_sending(out, TWO_FOCI, lambda: out.status().emitting, "sound")
        assert out.process
        children = _children(out.process.pid)
        assert len(children) == 1
    end = time.monotonic() + PATIENCE
    while _alive(children[0]) and time.monotonic() < end:
        time.sleep(0.02)
    assert not _alive(children[0])


def _children(parent: int) -> list[int]:
    table = subprocess.run(
        ["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True
    ).stdout
    rows = [tuple(map(int, line.split())) for line in table.splitlines()]
    return [pid for pid, above in rows if above == parent]


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_the_command_can_be_run_from_its_module(capsys: pytest.CaptureFixture[Any]) -> None:
    """Parse arguments itself, as it must in a process that a client starts."""
    assert command.main(["--nonsense"]) == 2
    assert "unrecognized" in capsys.readouterr().err
