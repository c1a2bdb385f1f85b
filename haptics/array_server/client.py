# SPDX-License-Identifier: GPL-3.0-or-later
"""The other end of the array server: what a simulation sends its focal points with."""

from __future__ import annotations

import contextlib
import json
import queue
import select
import socket
import subprocess
import threading
import time
from dataclasses import dataclass, field, fields
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...solver.core.errors import TactileClayError
from ..protocol.datagram import (
    MAX_FOCI,
    MAX_SIZE,
    Datagram,
    DatagramError,
    Kind,
    Modulation,
    decode,
    encode,
)
from .launch import start_process
from .limits import Limits

DEFAULT_PORT = 17717
"""Port of a server that was started by hand."""
_clock = time.monotonic
_START_TIMEOUT = 20.0
_STOP_TIMEOUT = 3.0
_HEARD_WITHIN = 0.5
"""A server that has sent no status for this long counts as lost [s]; it sends ten a second."""


class ArrayServerError(TactileClayError):
    """The array server cannot be started or does not answer; the message says what to do."""


class FocalPoints(Protocol):
    """Anything with focal points, such as the `Foci` that `focus` gives."""

    @property
    def positions(self) -> NDArray[np.floating]:
        """Positions [m], shape [K, 3]."""

    @property
    def pressures(self) -> NDArray[np.floating]:
        """Pressure amplitudes [Pa], shape [K]."""


@dataclass(frozen=True)
class ArrayStatus:
    """What an array server last said about itself."""

    heard: bool = False
    """Whether it has said so within the last half second; otherwise the rest is out of date."""
    device: str = ""
    """Name of its device."""
    connected: bool = False
    """Whether the device is there and takes what it is sent."""
    emitting: bool = False
    """Whether there is sound; while not connected, whether there may still be."""
    foci: int = 0
    """Focal points that sound."""
    frames_per_second: int = 0
    """Frames that the device got within the last second."""
    latency: float | None = None
    """Median time from sending focal points to their last byte leaving for the device [s]."""
    latency_p99: float | None = None
    """99th percentile of it [s]."""
    losses: int = 0
    """How often the device was lost so far."""
    dropped: int = 0
    """Focal points that newer ones replaced before the device was free, in datagrams."""
    refused: dict[str, int] = field(default_factory=dict)
    """Datagrams that were not let through, by reason."""
    outside: int = 0
    """Focal points left out because they lay outside the array's working volume."""
    on_time_left: float = 0.0
    """Sound that is left before a pause [s]."""
    fault: str = ""
    """What is wrong, for people; empty if nothing is."""


class ArrayClient:
    """Sends focal points to an array server on this machine.

    The server makes the array silent when it has got nothing for 150 ms: send every frame, also
    when nothing has changed. No method waits for the server but those that say so.

    Example:
        >>> with ArrayClient.start("simulated") as out:
        ...     out.send(foci)
        ...     print(out.status().frames_per_second)

    Args:
        port: Where the server listens on 127.0.0.1.
        session: The number it goes by; 0 for a server that was started by hand.
        pose: World from the array's own coordinates, shape [4, 4]; focal points are sent in world
            coordinates. The identity where not given.
    """

    def __init__(self, port: int, *, session: int = 0, pose: ArrayLike | None = None) -> None:
        self.port = port
        self.session = session
        self.process: subprocess.Popen[bytes] | None = None
        """The server's process, if `start` started it."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        # Later clients of one server go on counting where earlier ones have not been yet.
        self._sequence = time.monotonic_ns()
        self._status = ArrayStatus()
        self._heard_at = -1e9
        self._drive: NDArray[np.complex128] | None = None
        self.set_pose(np.eye(4) if pose is None else pose)

    @classmethod
    def start(
        cls, device: str, *, pose: ArrayLike | None = None, limits: Limits | None = None
    ) -> Self:
        """Start a server in a process of its own, which ends with this one, and connect to it.

        Waits until it runs: a second or so. That its device is connected, `status` tells later.

        Args:
            device: As ``simulated``, ``sonicsurface:/dev/ttyUSB0``; see `DeviceName`.
            pose: See the class.
            limits: Caps that are lower than usual.

        Raises:
            ArrayServerError: It does not start; the message is what it says.
        """
        words = [device, "--for-client"]
        if limits is not None:
            words += ["--amplitude-cap", str(limits.amplitude)]
            words += ["--pressure-cap", str(limits.pressure), "--on-time", str(limits.on_time)]
        try:
            process = start_process("server", words, stdout=subprocess.PIPE)
        except OSError as error:
            raise ArrayServerError(f"The array server cannot be started ({error}).") from error
        line = _first_line(process)
        try:
            said = json.loads(line)
            client = cls(said["port"], session=said["session"], pose=pose)
        except (ValueError, KeyError, TypeError) as error:
            process.kill()
            process.wait()
            reason = line.decode(errors="replace").strip() or "it said nothing"
            raise ArrayServerError(f"The array server did not start: {reason}") from error
        client.process = process
        client.hello()
        return client

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def set_pose(self, pose: ArrayLike) -> None:
        """Say where the array stands.

        Args:
            pose: World from the array's own coordinates: a rotation and a shift [m], shape [4, 4].

        Raises:
            ValueError: It is not that.
        """
        matrix = np.array(pose, np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError("The pose of an array is a finite matrix of shape (4, 4).")
        turn = matrix[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0.0:
            raise ValueError(
                "An array can be moved and turned only: its pose must not scale, shear or mirror."
            )
        self._turn, self._shift = turn, matrix[:3, 3]

    def send(
        self,
        foci: FocalPoints,
        *,
        modulation: Modulation = Modulation.AMPLITUDE,
        time: float | None = None,
    ) -> None:
        """Send focal points; none of them, or pressures of 0, mean silence.

        Args:
            foci: Anything with positions in world coordinates [m], shape [K, 3], and pressures
                [Pa], shape [K]; those that are not finite are left out, and of too many the
                strongest stay.
            modulation: How to make them felt.
            time: When the contact forces were taken, by `time.monotonic` [s]; now if not given.
        """
        positions = np.asarray(foci.positions, np.float64).reshape(-1, 3)
        pressures = np.asarray(foci.pressures, np.float64).reshape(-1)
        good = np.isfinite(positions).all(axis=1) & np.isfinite(pressures) & (pressures > 0.0)
        positions, pressures = positions[good], pressures[good]
        if len(pressures) > MAX_FOCI:
            strongest = np.argsort(-pressures)[:MAX_FOCI]
            positions, pressures = positions[strongest], pressures[strongest]
        self._send(
            Kind.FOCI,
            time=time,
            modulation=modulation,
            positions=(positions - self._shift) @ self._turn,
            pressures=pressures,
        )

    def silence(self) -> None:
        """Be silent now."""
        self._send(Kind.FOCI)

    def hello(self) -> None:
        """Ask for a status, without focal points."""
        self._send(Kind.HELLO)

    def status(self, *, wait: float = 0.0) -> ArrayStatus:
        """What the server last said.

        Args:
            wait: Wait up to this long [s] for a status that is newer than the last.
        """
        self._read(wait, Kind.STATUS)
        heard = time.monotonic() - self._heard_at < _HEARD_WITHIN
        ended = self.process is not None and self.process.poll() is not None
        table = {entry.name: getattr(self._status, entry.name) for entry in fields(ArrayStatus)}
        table["heard"] = heard and not ended
        if ended:
            table["connected"] = False
            table["fault"] = table["fault"] or "The array server has ended."
        return ArrayStatus(**table)

    def drive(self, *, wait: float = 2.0) -> NDArray[np.complex128]:
        """The drive that the device holds, after caps and quantization, shape [T].

        Args:
            wait: Wait up to this long for the answer [s].

        Raises:
            ArrayServerError: There was none.
        """
        self._drive = None
        end = time.monotonic() + wait
        while self._drive is None:
            # A question that is old when the server reads it is not answered either.
            self._send(Kind.ASK_DRIVE)
            self._read(min(0.25, wait), Kind.DRIVE)
            if self._drive is None and time.monotonic() >= end:
                raise ArrayServerError("The array server does not answer.")
        return self._drive

    def close(self) -> None:
        """Silence the array; a server that this client started ends, and is waited for."""
        process = self.process
        with contextlib.suppress(OSError):
            self._send(Kind.FOCI if process is None else Kind.STOP)
        if process is not None:
            # The end of its standard input would do as well, if the datagram were lost.
            if process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()
            try:
                process.wait(_STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                # Its guard silences the array then.
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        self._socket.close()

    def _send(self, kind: Kind, *, time: float | None = None, **values: Any) -> None:
        self._sequence += 1
        data = encode(
            kind,
            session=self.session,
            sequence=self._sequence,
            time=_clock() if time is None else time,
            **values,
        )
        # Nobody listens, or the system is out of buffers: status says so.
        with contextlib.suppress(BlockingIOError, ConnectionError):
            self._socket.sendto(data, ("127.0.0.1", self.port))

    def _read(self, wait: float, until: Kind) -> None:
        end = time.monotonic() + wait
        found = False
        while True:
            try:
                data, address = self._socket.recvfrom(MAX_SIZE)
            except (BlockingIOError, ConnectionError):
                left = end - time.monotonic()
                if found or left <= 0.0:
                    return
                select.select([self._socket], [], [], left)
                continue
            if address != ("127.0.0.1", self.port):
                continue
            with contextlib.suppress(DatagramError, TypeError, KeyError, ValueError):
                datagram = decode(data)
                if datagram.session == self.session and datagram.table is not None:
                    self._take(datagram)
                    found = found or datagram.kind is until

    def _take(self, datagram: Datagram) -> None:
        table = datagram.table or {}
        if datagram.kind is Kind.STATUS:
            self._status = ArrayStatus(heard=True, **table)
            # It may have waited here for long.
            self._heard_at = datagram.time
        elif datagram.kind is Kind.DRIVE:
            self._drive = np.array(table["real"]) + 1j * np.array(table["imaginary"])


def _first_line(process: subprocess.Popen[bytes]) -> bytes:
    """The first line that a process writes, or nothing if it takes too long."""
    assert process.stdout is not None
    stream = process.stdout
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=lambda: lines.put(stream.readline()), daemon=True).start()
    with contextlib.suppress(queue.Empty):
        return lines.get(timeout=_START_TIMEOUT)
    return b""
