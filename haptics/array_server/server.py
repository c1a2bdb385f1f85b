# SPDX-License-Identifier: GPL-3.0-or-later
"""The array server's loop: focal points in, a device's frames out, and silence when in doubt."""

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
"""The loop looks around at least this often [s]."""
_STATUS_EVERY = 0.1
_RECONNECT_EVERY = 0.25
_FAULT_SHOWN = 1.0
"""What was wrong and is no longer is still told for this long [s]."""
_MAX_AT_ONCE = 1000
"""Datagrams read in one go: a flood must not keep the loop from its other duties."""


class ArrayServer:
    """Listens on loopback, and drives one device.

    Only the newest focal points count: what comes in while the device is busy replaces what has not
    been sent. The device is silent unless the newest focal points that `Gate` let through are
    fresh and `OnTime` allows sound; whatever goes wrong, it is made silent first.

    Args:
        device: The device, not yet open.
        name: Its name, for the status.
        limits: Caps that no message can lift.
        port: Port on 127.0.0.1; 0 for any that is free.
        session: Number that datagrams must bear.
        clock: The monotonic clock [s], which clients share.
        guard: Who silences the device if this process cannot.

    Raises:
        OSError: The port is taken.
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
        """Whether the device was last told to sound; kept, as unknown, while not `connected`."""
        self.fault = ""
        """What is wrong, for people."""
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
        self._lost_at = -math.inf
        self._dropped = 0
        self._refused: dict[str, int] = {}
        self._frames: deque[float] = deque(maxlen=4096)
        self._latencies: deque[float] = deque(maxlen=512)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._socket.getsockname()[1])

    def run(self) -> None:
        """Serve until `stopping` is set or a client says so; the device is silent afterwards."""
        try:
            while not self.stopping:
                self.step()
        finally:
            self.close()

    def step(self, longest: float = _MAX_WAIT) -> None:
        """Wait for a datagram or for something that is due, and do what there is to do.

        Args:
            longest: Wait no longer than this [s].
        """
        self._wait(longest)
        now = self._look_at_clock()
        self._receive(now)
        self._connect(now)
        self._judge(now)
        if self.connected:
            self._work(now)
        if self._guard is not None and now >= self._guard_at:
            self._guard.beat(emitting=self.emitting)
            self._guard_at = now + 0.1
        if now >= self._status_at:
            self._report(now)

    def close(self) -> None:
        """Silence the device, trying for a second where it cannot be reached, and let go of all."""
        if self.connected and self.emitting:
            self._silence(self._look_at_clock())
        end = time.monotonic() + 1.0
        while self.emitting and not self.connected and time.monotonic() < end:
            self._connect_at = -math.inf
            self._connect(self._look_at_clock())
            time.sleep(0.02)
        silent = not self.emitting
        self.device.close(self._look_at_clock())
        self.connected = False
        self._newest = None
        with contextlib.suppress(OSError):
            self._report(self._look_at_clock())
        self._socket.close()
        if self._guard is not None:
            self._guard.end(silent=silent)

    # What comes in --------------------------------------------------------------------------------

    def _wait(self, longest: float) -> None:
        now = self._clock()
        due = [longest, self._status_at - now]
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

    def _look_at_clock(self) -> float:
        now = self._clock()
        if now < self._time:
            # It cannot be known any more how old anything is.
            self._newest = None
            self._waiting = False
            self._connect_at = self._service_at = self._status_at = self._guard_at = now
            self._lost_at = now
            self.fault = "The clock went back."
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
                # Windows reports here that a client's port is closed.
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

    # What goes out --------------------------------------------------------------------------------

    def _connect(self, now: float) -> None:
        if self.connected or now < self._connect_at:
            return
        self._connect_at = now + _RECONNECT_EVERY
        try:
            self.device.open(now)
        except DeviceError as error:
            self.fault = str(error)
            self.device.close(now)
            return
        # Opening may take a while: what arrived before is judged again.
        self.connected, self.emitting = True, False
        self._service_at = self._status_at = now

    def _lose(self, now: float, error: Exception) -> None:
        self.connected = False
        self.fault = str(error)
        self._losses += 1
        self._lost_at = now
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

    def _judge(self, now: float) -> None:
        """Decide whether there may be sound, and end it where not."""
        self.on_time.advance(now, emitting=self.emitting)
        newest = self._newest
        if newest is not None and not 0.0 <= now - newest.time + 0.005 <= STALE_AFTER + 0.005:
            self._newest = newest = None
            self._dropped += self._waiting
            self._waiting = False
        wanted = newest is not None and len(newest.positions) > 0
        guarded = self._guard is None or self._guard.ready
        if not wanted or not self.on_time.allowed or not guarded:
            self._waiting = False
            if self.emitting and self.connected:
                self._silence(now)
        if not self.on_time.allowed:
            self.fault = "The on-time limit is reached: a pause."
        elif self.connected and now - self._lost_at > _FAULT_SHOWN:
            self.fault = ""

    def _work(self, now: float) -> None:
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
                self.fault, self._lost_at = f"No drive was found ({error}).", now
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
        # Before it is told so: if that fails half way, it may sound.
        self.emitting = True
        sounds_at = self.device.emit(emission, self._clock())
        self._foci = len(newest.positions)
        self._frames.append(now)
        self._latencies.append(sounds_at - newest.time)

    # What is said about it ------------------------------------------------------------------------

    def status(self, now: float) -> dict[str, Any]:
        """How it goes, see `ArrayStatus`."""
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
        self._status_at = now + _STATUS_EVERY
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
        # A client that does not listen is no fault of the array's.
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._client)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
