# SPDX-License-Identifier: GPL-3.0-or-later
"""The main loop of the array server: receives focal points, drives a device, ensures silence."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from ..acoustics.drive import solve_drive
from ..devices import Device, DeviceError, Emission
from ..protocol.datagram import MAX_SIZE, Datagram, Kind, Modulation, encode
from .guard import Guard
from .limits import STALE_AFTER, Gate, Limits, OnTime, RefusedError, cap_drive

_MAX_WAIT = 0.05
"""Maximum duration of a pass through the loop while nothing happens [s]."""
_STATUS_INTERVAL = 0.1
_RECONNECT_INTERVAL = 0.25
_FAULT_SHOWN = 1.0
"""A fault is reported for this long after it has ended [s]."""
_MAX_AT_ONCE = 1000
"""Maximum number of datagrams read in one pass: a flood must not block the loop's other tasks."""


class ArrayServer:
    """Listens on the loopback interface and drives one device.

    Only the newest focal points count: those that arrive while the device is busy replace any that
    have not been sent. The device is silent unless the newest focal points admitted by `Gate` are
    recent and `OnTime` allows sound. After any failure, the device is silenced first.

    Args:
        device: The device, not yet open.
        name: Name of the device, for the status.
        limits: Caps that no message can lift.
        port: Port on 127.0.0.1; 0 for any free port.
        session: Session number required in datagrams.
        clock: The monotonic clock [s], which clients share.
        guard: Silences the device if this process cannot.

    Raises:
        OSError: The port is in use.
    """

    def __init__(
        self,
        device: Device,
        *,
        name: str = "",
        limits: Limits | None = None,
        port: int = 0,
        session: int = 0,
        clock: Callable[[], float] = time.monotonic,
        guard: Guard | None = None,
    ) -> None:
        self.device = device
        self.name = name
        self.limits = limits or Limits()
        self.session = session
        self.gate = Gate(
            device.array, self.limits, session=session, maximum_foci=device.maximum_foci
        )
        self.on_time = OnTime(self.limits.on_time)
        self.stopping = False
        """Set to end `run`."""
        self.connected = False
        self.emitting = False
        """Whether there is sound; after the connection is lost, whether there may still be."""
        self.fault = ""
        """Current problem as a sentence for the user."""
        self._clock = clock
        self._time = clock()
        self._guard = guard
        self._guard_at = -math.inf
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._client: tuple[str, int] | None = None
        self._newest: Datagram | None = None
        self._waiting = False
        self._foci = 0
        self._connect_at = -math.inf
        self._service_at = -math.inf
        self._status_at = -math.inf
        self._sequence = 0
        self._losses = 0
        self._fault_at = -math.inf
        self._dropped = 0
        self._refused: dict[str, int] = {}
        self._frames: deque[float] = deque(maxlen=4096)
        self._latencies: deque[float] = deque(maxlen=512)

    @property
    def port(self) -> int:
        """The port on which the server listens."""
        return int(self._socket.getsockname()[1])

    def run(self) -> None:
        """Serve until `stopping` is set or a client sends a stop; then silence the device."""
        try:
            while not self.stopping:
                self.step()
        finally:
            self.close()

    def step(self, max_wait: float = _MAX_WAIT) -> None:
        """Make one pass through the loop: wait for a datagram or the next task, then handle it.

        Args:
            max_wait: Maximum time to wait [s].
        """
        self._wait(max_wait)
        now = self._read_clock()
        self._receive(now)
        self._connect(now)
        self._enforce_limits(now)
        if self.connected:
            self._drive_device(now)
        if self._guard is not None and now >= self._guard_at:
            self._guard.beat(emitting=self.emitting)
            self._guard_at = now + 0.1
        if now >= self._status_at:
            self._report(now)

    def close(self) -> None:
        """Silence the device, with retries for a second, and release it, the port and the guard."""
        if self.connected and self.emitting:
            self._silence(self._read_clock())
        end = time.monotonic() + 1.0
        while self.emitting and not self.connected and time.monotonic() < end:
            self._connect_at = -math.inf
            self._connect(self._read_clock())
            time.sleep(0.02)
        silent = not self.emitting
        self.device.close(self._read_clock())
        self.connected = False
        self._newest = None
        with contextlib.suppress(OSError):
            self._report(self._read_clock())
        self._socket.close()
        if self._guard is not None:
            self._guard.end(silent=silent)

    # Receiving ------------------------------------------------------------------------------------

    def _wait(self, max_wait: float) -> None:
        now = self._clock()
        due = [max_wait, self._status_at - now]
        if self.connected:
            due.append(self._service_at - now)
            if self._waiting:
                due.append(self.device.busy(now))
        else:
            due.append(self._connect_at - now)
        if self.emitting and self._newest is not None:
            due.append(self._newest.time + STALE_AFTER - now)
        with contextlib.suppress(OSError):
            select.select([self._socket], [], [], max(0.0, min(due)))

    def _read_clock(self) -> float:
        now = self._clock()
        if now < self._time:
            # The age of everything received so far is now unknown.
            self._newest = None
            self._waiting = False
            self._connect_at = self._service_at = self._status_at = self._guard_at = now
            self._fault_at = now
            self.fault = "The clock went backward."
            if self.connected and self.emitting:
                self._silence(now)
        self._time = now
        return now

    def _receive(self, now: float) -> None:
        for _ in range(_MAX_AT_ONCE):
            try:
                data, address = self._socket.recvfrom(MAX_SIZE + 1)
            except BlockingIOError:
                return
            except OSError:
                # Windows reports closed ports of clients here.
                continue
            try:
                datagram = self.gate.admit(data, now)
            except RefusedError as refused:
                reason = str(refused)
                self._refused[reason] = self._refused.get(reason, 0) + 1
                continue
            self._client = address
            if datagram.kind is Kind.FOCI:
                self._dropped += self._waiting
                self._newest, self._waiting = datagram, True
            elif datagram.kind is Kind.HELLO:
                self._status_at = now
            elif datagram.kind is Kind.ASK_DRIVE:
                self._send_drive(now)
            elif datagram.kind is Kind.STOP:
                self._newest, self._waiting = None, False
                self.stopping = True

    # Driving the device ---------------------------------------------------------------------------

    def _connect(self, now: float) -> None:
        if self.connected or now < self._connect_at:
            return
        self._connect_at = now + _RECONNECT_INTERVAL
        try:
            self.device.open(now)
        except DeviceError as error:
            self.fault = str(error)
            self.device.close(now)
            return
        # Opening may take a while, so `_enforce_limits` checks the age of the focal points again.
        self.connected, self.emitting = True, False
        self._service_at = self._status_at = now

    def _lose(self, now: float, error: Exception) -> None:
        self.connected = False
        self.fault = str(error)
        self._losses += 1
        self._fault_at = now
        self._foci = 0
        self._connect_at = now
        self._status_at = now
        self.device.close(now)

    def _silence(self, now: float) -> None:
        try:
            self.device.off(now)
        except DeviceError as error:
            self._lose(now, error)
            return
        self.emitting = False
        self._foci = 0
        self._service_at = self._status_at = now

    def _enforce_limits(self, now: float) -> None:
        """Silence the device unless the newest focal points are recent and sound is allowed."""
        self.on_time.advance(now, emitting=self.emitting)
        newest = self._newest
        if newest is not None and not 0.0 <= now - newest.time + 0.005 <= STALE_AFTER + 0.005:
            self._newest = newest = None
            self._dropped += self._waiting
            self._waiting = False
        has_foci = newest is not None and len(newest.positions) > 0
        guarded = self._guard is None or self._guard.ready
        if not has_foci or not self.on_time.allowed or not guarded:
            self._waiting = False
            if self.emitting and self.connected:
                self._silence(now)
        if not self.on_time.allowed:
            self.fault = "Paused because the on-time limit was reached."
        elif self.connected and now - self._fault_at > _FAULT_SHOWN:
            self.fault = ""

    def _drive_device(self, now: float) -> None:
        try:
            if self._waiting and self.device.busy(now) <= 0.0:
                self._emit(now)
            if now >= self._service_at or self.emitting:
                self._service_at = now + self.device.service(now)
        except DeviceError as error:
            self._lose(now, error)

    def _emit(self, now: float) -> None:
        newest = self._newest
        assert newest is not None
        self._waiting = False
        drive = np.zeros(0, np.complex128)
        if not self.device.takes_foci:
            array = self.device.array
            try:
                drive = solve_drive(array, newest.positions, newest.pressures)
                drive = cap_drive(array, drive, self.limits.amplitude)
            except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
                self.fault, self._fault_at = f"The drive could not be computed ({error}).", now
                self._newest = None
                if self.emitting:
                    self._silence(now)
                return
        emission = Emission(
            newest.positions,
            newest.pressures,
            drive,
            modulated=newest.modulation is Modulation.AMPLITUDE,
            amplitude_cap=self.limits.amplitude,
            pressure_cap=self.limits.pressure,
        )
        # Set beforehand, because the device may be sounding even if `emit` fails.
        self.emitting = True
        sounds_at = self.device.emit(emission, self._clock())
        self._foci = len(newest.positions)
        self._frames.append(now)
        self._latencies.append(sounds_at - newest.time)

    # Reporting ------------------------------------------------------------------------------------

    def status(self, now: float) -> dict[str, Any]:
        """The current status, with the fields of `ArrayStatus`."""
        while self._frames and self._frames[0] < now - 1.0:
            self._frames.popleft()
        latencies = np.array(self._latencies or [math.nan])
        return {
            "device": self.name,
            "connected": self.connected,
            "emitting": self.emitting,
            "foci": self._foci if self.emitting else 0,
            "frames_per_second": len(self._frames),
            "latency": _or_none(float(np.median(latencies))),
            "latency_p99": _or_none(float(np.percentile(latencies, 99.0))),
            "losses": self._losses,
            "dropped": self._dropped,
            "refused": self._refused,
            "outside": self.gate.outside,
            "on_time_left": self.on_time.left,
            "fault": self.fault,
        }

    def _report(self, now: float) -> None:
        self._status_at = now + _STATUS_INTERVAL
        self._send(Kind.STATUS, self.status(now), now)

    def _send_drive(self, now: float) -> None:
        held = self.device.held
        table = {"real": held.real.round(6).tolist(), "imaginary": held.imag.round(6).tolist()}
        self._send(Kind.DRIVE, table, now)

    def _send(self, kind: Kind, table: dict[str, Any], now: float) -> None:
        if self._client is None:
            return
        self._sequence += 1
        data = encode(
            kind, session=self.session, sequence=self._sequence, time=max(0.0, now), table=table
        )
        # A client that has gone is not a fault of the array.
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._client)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
