# SPDX-License-Identifier: GPL-3.0-or-later
"""AUTD3, through its own packages (autd3 0.12), which users of the device install themselves.

Only data sent by the server's loop resets the device's own watchdog, so the device silences itself
150 ms after the server is killed, is stopped or hangs. Tested only with the emulators of the
packages, never on a device.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..acoustics.transducer_array import TransducerArray
from .device import MODULATION_FREQUENCY, Device, DeviceError, DeviceName, Emission

WATCHDOG_MILLISECONDS = 150
_SEND_TIMEOUT = 0.08
_CONNECT_TIMEOUT = 1.5
_FRAME_SECONDS = 0.002
_CHECK_INTERVAL = 0.04
_SAMPLING_RATE = 4000.0

_T = TypeVar("_T")


def load_autd3() -> Any:
    """Import the module `autd3`.

    Raises:
        DeviceError: The packages are not installed, or have another version.
    """
    try:
        autd3 = importlib.import_module("autd3")
        for part in ("autd3_modulation", "autd3_pattern"):
            importlib.import_module(part)
    except ImportError as error:
        raise DeviceError(
            "The AUTD3 packages are missing. Add autd3, autd3-pattern and autd3-modulation, "
            f"version 0.12, to this Python ({error})."
        ) from error
    return autd3


class DeviceAUTD3(Device):
    """``autd3``, ``autd3:INTERFACE`` or ``autd3:HOST:PORT``: one device on Ethernet.

    INTERFACE is the name of a network interface; HOST:PORT is the address of an emulator.
    Intensities are in 255ths, phases in 256ths of a period. The device itself modulates.
    """

    has_watchdog = True

    def __init__(self, name: DeviceName) -> None:
        name.check_options()
        self._autd3 = load_autd3()
        self._address = name.address
        # The device's table of pulse widths makes the amplitude proportional to the intensity.
        self.array = replace(TransducerArray.preset("autd3"), amplitude_steps=None)
        self._loop = asyncio.new_event_loop()
        self._client: Any = None
        self._modulated: bool | None = None
        self._pattern: Any = None
        self._free_at = 0.0

    def open(self, now: float) -> None:
        """Connect, arm the watchdog, and silence the device."""
        from autd3 import commands
        from autd3_core import Autd3, Duration, Geometry

        self._release()
        interface = self._autd3.Interface.Auto
        if ":" in self._address:
            interface = self._autd3.Interface.Addr(self._address)
        elif self._address:
            interface = self._autd3.Interface.Name(self._address)
        geometry = Geometry([Autd3()])
        places = np.asarray(geometry[0].positions(), np.float64) * 1e-3
        # The origin of the packages is the first transducer.
        places -= 0.5 * (places.min(axis=0) + places.max(axis=0))
        if not np.allclose(places, self.array.positions, atol=1e-5):
            raise DeviceError("The geometry of the autd3 packages differs from the preset autd3.")
        # The client's own heartbeat would reset the watchdog even while this process hangs.
        option = self._autd3.UdpOption(iface=interface, heartbeat=None)
        config = self._autd3.ClientConfig()
        self._client = self._run(
            lambda: self._autd3.Client.open(geometry, option, config), timeout=_CONNECT_TIMEOUT
        )
        watchdog = commands.CpuConfig(failsafe_timeout=Duration.from_millis(WATCHDOG_MILLISECONDS))
        self._send(commands.Clear(), commands.SetCpuConfig(watchdog), commands.ReleaseFailsafe())
        self._modulated = None
        self.off(now)

    def busy(self, now: float) -> float:
        """Time until two milliseconds after the last frame [s]."""
        return max(0.0, self._free_at - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Set phases and intensities, and the modulation if it has changed."""
        if emission.modulated is not self._modulated:
            self._send(self._modulation(modulated=emission.modulated))
            self._modulated = emission.modulated
        highest = np.floor(255.0 * emission.amplitude_cap)
        amplitudes = np.minimum(np.rint(255.0 * np.abs(emission.drive)), highest)
        phases = np.rint(np.angle(emission.drive) * (256.0 / (2.0 * np.pi))) % 256.0
        self._pattern = self._command(phases, amplitudes)
        self._send(self._pattern)
        self._free_at = now + _FRAME_SECONDS
        turn = np.exp(2j * np.pi * phases / 256.0)
        self.held = np.asarray(amplitudes / 255.0 * turn, np.complex128)
        return now

    def off(self, now: float) -> None:
        """Set all intensities to 0."""
        nothing = np.zeros(self.array.count)
        self._pattern = self._command(nothing, nothing)
        self.held = np.zeros(self.array.count, np.complex128)
        self._send(self._pattern)

    def service(self, now: float) -> float:
        """Read the device's state, which resets the watchdog, and resume if it was triggered."""
        from autd3 import commands

        (state,) = self._run(lambda: self._opened.read_fpga_state())
        if state.is_failsafe_active():
            self._send(commands.ReleaseFailsafe(), self._pattern)
        return _CHECK_INTERVAL

    def close(self, now: float) -> None:
        """Set all intensities to 0, and disconnect."""
        if self._client is not None:
            with contextlib.suppress(DeviceError):
                self.off(now)
        self._release()

    def _command(self, phases: NDArray[Any], amplitudes: NDArray[Any]) -> Any:
        from autd3 import commands
        from autd3_pattern import IntensityBuffer, PhaseBuffer

        return commands.Pattern(
            PhaseBuffer.from_array(phases.astype(np.uint8)[None]),
            IntensityBuffer.from_array(amplitudes.astype(np.uint8)[None]),
        )

    def _modulation(self, *, modulated: bool) -> Any:
        from autd3 import commands
        from autd3_core import SamplingConfig
        from autd3_modulation import ModulationBuffer

        count = round(_SAMPLING_RATE / MODULATION_FREQUENCY)
        wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(count) / count)
        samples = np.rint(255.0 * (wave if modulated else np.ones(count))).astype(np.uint8)
        return commands.Modulation(SamplingConfig.FREQ_4K, ModulationBuffer.from_array(samples))

    def _send(self, *commands: Any) -> None:
        async def send() -> None:
            for command in commands:
                await self._opened.send(command)

        self._run(send)

    def _run(self, begin: Callable[[], Awaitable[_T]], *, timeout: float = _SEND_TIMEOUT) -> _T:
        async def wait() -> _T:
            return await asyncio.wait_for(begin(), timeout)

        from autd3_core import Autd3Error

        try:
            return self._loop.run_until_complete(wait())
        except (Autd3Error, OSError, TimeoutError) as error:
            reason = str(error) or "it does not answer"
            raise DeviceError(f"The AUTD3 failed to execute a command: {reason}.") from error

    def _release(self) -> None:
        if self._client is not None:
            with contextlib.suppress(DeviceError):
                self._run(lambda: self._client.close())
            self._client = None

    @property
    def _opened(self) -> Any:
        if self._client is None:
            raise DeviceError("The AUTD3 is not connected.")
        return self._client
