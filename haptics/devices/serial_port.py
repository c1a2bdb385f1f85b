# SPDX-License-Identifier: GPL-3.0-or-later
"""A serial port that never blocks long and knows what is still on the wire."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any

from .device import DeviceError, FoundDevice

if TYPE_CHECKING:
    import serial

WRITE_TIMEOUT = 0.08
"""A port that takes nothing for this long is given up [s]."""
_BITS_A_BYTE = 10
"""Start bit, eight data bits, stop bit."""


def load_pyserial() -> Any:
    """The module `serial`.

    Raises:
        DeviceError: pyserial is not installed.
    """
    try:
        import serial
        import serial.tools.list_ports
    except ImportError as error:
        raise DeviceError(
            "pyserial is missing, which serial arrays need. Install the extension from its zip, "
            "which brings it along, or add the package pyserial to this Python."
        ) from error
    return serial


def list_ports(kind: str) -> list[FoundDevice]:
    """The USB serial ports that are plugged in, each as a device of a kind.

    Raises:
        DeviceError: pyserial is not installed.
    """
    ports = load_pyserial().tools.list_ports.comports()
    return [
        FoundDevice(f"{kind}:{port.device}", f"{port.description} ({port.hwid})")
        for port in sorted(ports, key=lambda port: str(port.device))
        if port.vid is not None
    ]


def choose_port(kind: str, address: str) -> str:
    """The port at an address, or the only one that is plugged in where none is given.

    Raises:
        DeviceError: None is given, and there is none or more than one.
    """
    if address:
        return address
    found = list_ports(kind)
    if len(found) != 1:
        names = ", ".join(device.name for device in found) or "none"
        raise DeviceError(
            f"Say which serial port the array is on, as {kind}:PORT. Plugged in: {names}."
        )
    return found[0].name.partition(":")[2]


class SerialPort:
    """An open port, 8N1.

    What is written lies in the system's buffers until the wire has taken it; the port reckons from
    the baud rate when that will be, so that nothing queues up behind it.

    Args:
        path: As ``/dev/ttyUSB0`` or ``COM3``; a URL that pyserial knows, such as ``socket://…``.
        baud: Bits a second.

    Raises:
        DeviceError: It cannot be opened.
    """

    def __init__(self, path: str, baud: int) -> None:
        module = load_pyserial()
        self.path = path
        self.baud = baud
        self._errors: tuple[type[Exception], ...] = _port_errors(module)
        self._free_at = 0.0
        try:
            port = module.serial_for_url(path, do_not_open=True)
            port.baudrate = baud
            port.timeout = 0
            port.write_timeout = WRITE_TIMEOUT
            if "://" not in path:
                # Two processes that write to one array make a mess of its frames.
                port.exclusive = True
            port.open()
        except self._errors as error:
            raise DeviceError(
                f"{path} cannot be opened ({_reason(error)}). Is the array plugged in, may you use "
                "the port, and does no other program hold it? See array-server --list."
            ) from error
        self._port: serial.SerialBase = port

    def seconds_for(self, count: int) -> float:
        """How long the wire takes for a number of bytes [s]."""
        return count * _BITS_A_BYTE / self.baud

    def pending(self, now: float) -> float:
        """How long the wire still takes for what was written [s]."""
        return max(0.0, self._free_at - now)

    def write(self, data: bytes, now: float) -> float:
        """Write all of it.

        Returns:
            When the last byte will have left, by the monotonic clock [s].

        Raises:
            DeviceError: The port is gone, or takes nothing.
        """
        try:
            self._port.write(data)
        except self._errors as error:
            # What the system still holds must not come out when the peer wakes up.
            self.discard(now)
            raise DeviceError(f"{self.path} takes no data ({_reason(error)}).") from error
        self._free_at = max(self._free_at, now) + self.seconds_for(len(data))
        return self._free_at

    def check(self) -> None:
        """See whether the port is still there, and throw away what came.

        Raises:
            DeviceError: It is gone.
        """
        self.read()

    def drain(self) -> None:
        """Wait until what was written has left, no longer than a quarter of a second."""
        time.sleep(min(0.25, self.pending(time.monotonic())))

    def read(self) -> bytes:
        """What has come, without waiting.

        Raises:
            DeviceError: The port is gone.
        """
        try:
            return bytes(self._port.read(4096))
        except self._errors as error:
            raise DeviceError(f"{self.path} is gone ({_reason(error)}).") from error

    def discard(self, now: float) -> None:
        """Throw away what was written and has not left."""
        self._free_at = now
        with contextlib.suppress(*self._errors):
            self._port.reset_output_buffer()

    def close(self) -> None:
        """Let go of the port; raises nothing."""
        with contextlib.suppress(*self._errors):
            self._port.close()


def _port_errors(module: Any) -> tuple[type[Exception], ...]:
    errors: tuple[type[Exception], ...] = (module.SerialException, OSError, ValueError)
    # What pyserial lets through when a terminal goes away is none of these.
    with contextlib.suppress(ImportError):
        import termios

        errors = (*errors, termios.error)
    return errors


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error)
