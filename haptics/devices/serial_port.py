# SPDX-License-Identifier: GPL-3.0-or-later
"""A serial port that never blocks for long and tracks what is still being transmitted."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any

from .device import DeviceError, FoundDevice

if TYPE_CHECKING:
    import serial

WRITE_TIMEOUT = 0.08
"""A port that accepts no data for this long counts as lost [s]."""
_BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""


def load_pyserial() -> Any:
    """Import the module `serial`.

    Raises:
        DeviceError: pyserial is not installed.
    """
    try:
        import serial
        import serial.tools.list_ports
    except ImportError as error:
        raise DeviceError(
            "Serial arrays need pyserial, which is missing. Install the extension from its zip, "
            "which includes it, or add the package pyserial to this Python."
        ) from error
    return serial


def list_ports(kind: str) -> list[FoundDevice]:
    """Connected USB serial ports, each as a device of a kind.

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
    """The port at an address; if it is empty, the only connected port.

    Raises:
        DeviceError: The address is empty, and no port or several are connected.
    """
    if address:
        return address
    found = list_ports(kind)
    if len(found) != 1:
        names = ", ".join(device.name for device in found) or "none"
        raise DeviceError(f"Give the serial port of the array, as {kind}:PORT. Connected: {names}.")
    return found[0].name.partition(":")[2]


class SerialPort:
    """An open port, 8N1.

    Written data stays in the system's buffers until it has been transmitted. The port computes from
    the baud rate when that will be, so that callers can avoid filling the buffers.

    Args:
        path: For example ``/dev/ttyUSB0`` or ``COM3``, or a URL of pyserial such as ``socket://…``.
        baud: Bits per second.

    Raises:
        DeviceError: The port cannot be opened.
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
                # Two processes that write to the same array would corrupt its frames.
                port.exclusive = True
            port.open()
        except self._errors as error:
            raise DeviceError(
                f"{path} cannot be opened ({_reason(error)}). Check that the array is connected, "
                "that you have permission to use the port and that no other program uses it. See "
                "array-server --list."
            ) from error
        self._port: serial.SerialBase = port

    def seconds_for(self, count: int) -> float:
        """Time to transmit a number of bytes [s]."""
        return count * _BITS_PER_BYTE / self.baud

    def pending(self, now: float) -> float:
        """Time until everything written so far has been transmitted [s]."""
        return max(0.0, self._free_at - now)

    def write(self, data: bytes, now: float) -> float:
        """Write all of the data.

        Returns:
            When the last byte will have been transmitted, by the monotonic clock [s].

        Raises:
            DeviceError: The port is gone or accepts no data.
        """
        try:
            self._port.write(data)
        except self._errors as error:
            # Buffered data must not be transmitted later, when the board responds again.
            self.discard(now)
            raise DeviceError(f"{self.path} accepts no data ({_reason(error)}).") from error
        self._free_at = max(self._free_at, now) + self.seconds_for(len(data))
        return self._free_at

    def check(self) -> None:
        """Check that the port still exists, and discard received data.

        Raises:
            DeviceError: The port is gone.
        """
        self.read()

    def drain(self) -> None:
        """Wait until everything has been transmitted, at most a quarter of a second."""
        time.sleep(min(0.25, self.pending(time.monotonic())))

    def read(self) -> bytes:
        """Return received data without waiting.

        Raises:
            DeviceError: The port is gone.
        """
        try:
            return bytes(self._port.read(4096))
        except self._errors as error:
            raise DeviceError(f"{self.path} is gone ({_reason(error)}).") from error

    def discard(self, now: float) -> None:
        """Discard data that has been written but not transmitted."""
        self._free_at = now
        with contextlib.suppress(*self._errors):
            self._port.reset_output_buffer()

    def close(self) -> None:
        """Close the port; raises no errors."""
        with contextlib.suppress(*self._errors):
            self._port.close()


def _port_errors(module: Any) -> tuple[type[Exception], ...]:
    errors: tuple[type[Exception], ...] = (module.SerialException, OSError, ValueError)
    # When a terminal disappears, pyserial raises termios.error, which is none of these.
    with contextlib.suppress(ImportError):
        import termios

        errors = (*errors, termios.error)
    return errors


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error)
