# SPDX-License-Identifier: GPL-3.0-or-later
"""Client of the array server, with which a simulation sends its focal points."""

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
"""Default port of a server started from the command line."""
_clock = time.monotonic
_START_TIMEOUT = 20.0
_STOP_TIMEOUT = 3.0
_LOST_AFTER = 0.5
"""A server that has sent no status for this long counts as lost [s]; it sends ten per second."""


class ArrayServerError(TactileClayError):
    """The array server cannot be started or does not answer; the message says what to do."""


class FocalPoints(Protocol):
    """Any object with focal points, such as the `Foci` returned by `focus`."""

    @property
    def positions(self) -> NDArray[np.floating]:
        """Positions [m], shape [K, 3]."""

    @property
    def pressures(self) -> NDArray[np.floating]:
        """Pressure amplitudes [Pa], shape [K]."""


@dataclass(frozen=True)
class ArrayStatus:
    """The latest status that an array server has sent."""

    heard: bool = False
    """Whether it arrived within the last half second; otherwise the rest is out of date."""
    device: str = ""
    """Name of the server's device."""
    connected: bool = False
    """Whether the device is connected and accepts data."""
    emitting: bool = False
    """Whether there is sound; while not connected, whether there may still be sound."""
    foci: int = 0
    """Number of focal points being emitted."""
    frames_per_second: int = 0
    """Number of frames sent to the device within the last second."""
    latency: float | None = None
    """Median time from sending focal points to their last byte leaving for the device [s]."""
    latency_p99: float | None = None
    """99th percentile of the latency [s]."""
    losses: int = 0
    """Number of times that the connection to the device was lost."""
    dropped: int = 0
    """Number of datagrams replaced by newer ones before the device was ready."""
    refused: dict[str, int] = field(default_factory=dict)
    """Number of rejected datagrams for each reason."""
    outside: int = 0
    """Number of focal points left out because they were outside the array's working volume."""
    on_time_left: float = 0.0
    """Time of sound left before a pause [s]."""
    fault: str = ""
    """Current problem as a sentence for the user; empty if there is none."""


class ArrayClient:
    """Sends focal points to an array server on this machine.

    The server silences the array if it receives nothing for 150 ms, so send every frame even if
    nothing has changed. Only methods that say so wait for the server.

    Example:
        >>> with ArrayClient.start("simulated") as out:
        ...     out.send(foci)
        ...     print(out.status().frames_per_second)

    Args:
        port: The server's port on 127.0.0.1.
        session: The server's session number; 0 for a server started from the command line.
        pose: World from array coordinates, shape [4, 4], to convert focal points from world
            coordinates; the identity if None.
    """

    def __init__(self, port: int, *, session: int = 0, pose: ArrayLike | None = None) -> None:
        self.port = port
        self.session = session
        self.process: subprocess.Popen[bytes] | None = None
        """The server's process if `start` started it, else None."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        # The sequence numbers of later clients of the same server must be higher.
        self._sequence = time.monotonic_ns()
        self._status = ArrayStatus()
        self._heard_at = -1e9
        self._drive: NDArray[np.complex128] | None = None
        self.set_pose(np.eye(4) if pose is None else pose)

    @classmethod
    def start(
        cls, device: str, *, pose: ArrayLike | None = None, limits: Limits | None = None
    ) -> Self:
        """Start a server in a separate process that ends with this one, and connect to it.

        Waits about a second until the server runs. The device may connect later; see `status`.

        Args:
            device: For example ``simulated`` or ``sonicsurface:/dev/ttyUSB0``; see `DeviceName`.
            pose: See the class.
            limits: Lower caps than the default.

        Raises:
            ArrayServerError: The server does not start; the message quotes what it printed.
        """
        arguments = [device, "--for-client"]
        if limits is not None:
            arguments += ["--amplitude-cap", str(limits.amplitude)]
            arguments += ["--pressure-cap", str(limits.pressure), "--on-time", str(limits.on_time)]
        try:
            process = start_process("server", arguments, stdout=subprocess.PIPE)
        except OSError as error:
            raise ArrayServerError(f"The array server cannot be started ({error}).") from error
        line = _first_line(process)
        try:
            server = json.loads(line)
            client = cls(server["port"], session=server["session"], pose=pose)
        except (ValueError, KeyError, TypeError) as error:
            process.kill()
            process.wait()
            reason = line.decode(errors="replace").strip() or "it printed nothing"
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
        """Set the pose of the array.

        Args:
            pose: World from array coordinates, a rotation and a translation [m], shape [4, 4].

        Raises:
            ValueError: The matrix is not such a pose.
        """
        matrix = np.array(pose, np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError("The pose of an array must be a finite matrix of shape (4, 4).")
        rotation = matrix[:3, :3]
        orthogonal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
        if not orthogonal or np.linalg.det(rotation) < 0.0:
            raise ValueError(
                "An array can only be moved and rotated: its pose must not scale, shear or mirror."
            )
        self._rotation, self._translation = rotation, matrix[:3, 3]

    def send(
        self,
        foci: FocalPoints,
        *,
        modulation: Modulation = Modulation.AMPLITUDE,
        time: float | None = None,
    ) -> None:
        """Send focal points; no focal points, or only pressures of 0, mean silence.

        Args:
            foci: Any object with positions in world coordinates [m], shape [K, 3], and pressures
                [Pa], shape [K]. Values that are not finite are left out; if there are too many
                focal points, the strongest are sent.
            modulation: How to modulate the sound.
            time: When the contact forces were computed, by `time.monotonic` [s]; None for now.
        """
        positions = np.asarray(foci.positions, np.float64).reshape(-1, 3)
        pressures = np.asarray(foci.pressures, np.float64).reshape(-1)
        valid = np.isfinite(positions).all(axis=1) & np.isfinite(pressures) & (pressures > 0.0)
        positions, pressures = positions[valid], pressures[valid]
        if len(pressures) > MAX_FOCI:
            strongest = np.argsort(-pressures)[:MAX_FOCI]
            positions, pressures = positions[strongest], pressures[strongest]
        self._send(
            Kind.FOCI,
            time=time,
            modulation=modulation,
            positions=(positions - self._translation) @ self._rotation,
            pressures=pressures,
        )

    def silence(self) -> None:
        """Silence the array now."""
        self._send(Kind.FOCI)

    def hello(self) -> None:
        """Request a status without sending focal points."""
        self._send(Kind.HELLO)

    def status(self, *, wait: float = 0.0) -> ArrayStatus:
        """The server's latest status.

        Args:
            wait: Wait up to this long for a status newer than the previous one [s].
        """
        self._read(wait, Kind.STATUS)
        heard = time.monotonic() - self._heard_at < _LOST_AFTER
        ended = self.process is not None and self.process.poll() is not None
        table = {entry.name: getattr(self._status, entry.name) for entry in fields(ArrayStatus)}
        table["heard"] = heard and not ended
        if ended:
            table["connected"] = False
            table["fault"] = table["fault"] or "The array server has ended."
        return ArrayStatus(**table)

    def drive(self, *, wait: float = 2.0) -> NDArray[np.complex128]:
        """The device's current drive, after caps and quantization, shape [T].

        Args:
            wait: Wait up to this long for the answer [s].

        Raises:
            ArrayServerError: The server did not answer.
        """
        self._drive = None
        end = time.monotonic() + wait
        while self._drive is None:
            # Ask repeatedly, because the server ignores requests that are old when it reads them.
            self._send(Kind.ASK_DRIVE)
            self._read(min(0.25, wait), Kind.DRIVE)
            if self._drive is None and time.monotonic() >= end:
                raise ArrayServerError("The array server does not answer.")
        return self._drive

    def close(self) -> None:
        """Silence the array; if this client started the server, stop it and wait for its end."""
        process = self.process
        with contextlib.suppress(OSError):
            self._send(Kind.FOCI if process is None else Kind.STOP)
        if process is not None:
            # If the datagram is lost, the end of its standard input stops the server.
            if process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()
            try:
                process.wait(_STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                # The guard then silences the array.
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
        # If nobody listens or the system is out of buffers, `status` shows it.
        with contextlib.suppress(BlockingIOError, ConnectionError):
            self._socket.sendto(data, ("127.0.0.1", self.port))

    def _read(self, wait: float, until: Kind) -> None:
        """Read all datagrams that have arrived, and wait for one of a kind if there is none."""
        end = time.monotonic() + wait
        found = False
        while True:
            try:
                data, address = self._socket.recvfrom(MAX_SIZE)
            except (BlockingIOError, ConnectionError):
                remaining = end - time.monotonic()
                if found or remaining <= 0.0:
                    return
                select.select([self._socket], [], [], remaining)
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
            # The datagram may have waited in the socket's buffer for long.
            self._heard_at = datagram.time
        elif datagram.kind is Kind.DRIVE:
            self._drive = np.array(table["real"]) + 1j * np.array(table["imaginary"])


def _first_line(process: subprocess.Popen[bytes]) -> bytes:
    """The first line that a process prints; empty if it takes too long."""
    assert process.stdout is not None
    stream = process.stdout
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=lambda: lines.put(stream.readline()), daemon=True).start()
    with contextlib.suppress(queue.Empty):
        return lines.get(timeout=_START_TIMEOUT)
    return b""
