# SPDX-License-Identifier: GPL-3.0-or-later
"""An FTDI chip in FIFO mode, which outputs written data on its parallel port; accessed by pyusb.

Uses FTDI's control requests reset and purge (0) and latency (9). The FIFO mode itself is set in the
chip's EEPROM.
"""

from __future__ import annotations

import contextlib
from typing import Any

from .device import DeviceError

VENDOR = 0x0403
PRODUCTS = (0x6014, 0x6010, 0x6015)
"""FT232H, FT2232H and FT240X."""
WRITE_TIMEOUT = 0.08
"""A chip that accepts no data for this long counts as lost [s]."""
_OUT = 0x40
_RESET, _SET_LATENCY = 0, 9
_RESET_ALL, _PURGE_RECEIVED, _PURGE_SENT = 0, 1, 2
_LATENCY = 2


def load_pyusb() -> Any:
    """Import the module `usb`.

    Raises:
        DeviceError: pyusb is not installed.
    """
    try:
        import usb.core
        import usb.util
    except ImportError as error:
        raise DeviceError(
            "This array needs pyusb, which is missing. Install the extension from its zip, which "
            "includes it, or add the package pyusb to this Python."
        ) from error
    return usb


def find_backend() -> Any:
    """The pyusb backend of libusb-package if installed; None for pyusb's default."""
    with contextlib.suppress(ImportError):
        import libusb_package

        return libusb_package.get_libusb1_backend()
    return None


def find_chips() -> list[Any]:
    """All connected FTDI chips, as pyusb devices.

    Raises:
        DeviceError: pyusb or the library libusb is missing.
    """
    usb = load_pyusb()
    try:
        found = usb.core.find(find_all=True, idVendor=VENDOR, backend=find_backend())
        return [chip for chip in found if chip.idProduct in PRODUCTS]
    except usb.core.NoBackendError as error:
        raise DeviceError(
            "pyusb needs the library libusb-1.0, which is missing. Install it with the system's "
            "package manager (libusb-1.0-0 on Debian), or add the package libusb-package to this "
            "Python."
        ) from error
    except (usb.core.USBError, NotImplementedError) as error:
        raise DeviceError(f"USB devices cannot be listed ({error}).") from error


def serial_number(chip: Any) -> str:
    """Serial number of a chip; empty if access is denied."""
    # pyusb raises a ValueError if the strings of a device are not accessible.
    with contextlib.suppress(load_pyusb().core.USBError, ValueError, NotImplementedError):
        return str(chip.serial_number or "")
    return ""


class FtdiFifo:
    """An open chip, reset and with empty buffers.

    Args:
        serial: Serial number of the chip.

    Raises:
        DeviceError: There is no such chip, or it cannot be used.
    """

    def __init__(self, serial: str) -> None:
        self._usb = load_pyusb()
        self._serial = serial
        self._endpoint: Any = None
        chips = find_chips()
        numbers = {serial_number(chip): chip for chip in chips}
        if serial not in numbers:
            names = ", ".join(filter(None, numbers)) or "none"
            raise DeviceError(
                f"There is no FTDI chip with the serial number {serial}. Connected: {names}. "
                "If it is connected, you may lack permission to use it."
            )
        self._chip = numbers[serial]
        try:
            with contextlib.suppress(NotImplementedError, self._usb.core.USBError):
                if self._chip.is_kernel_driver_active(0):
                    self._chip.detach_kernel_driver(0)
            self._chip.set_configuration()
            interface = self._chip.get_active_configuration()[(0, 0)]
            self._usb.util.claim_interface(self._chip, interface.bInterfaceNumber)
            self._endpoint = next(
                point
                for point in interface
                if self._usb.util.endpoint_direction(point.bEndpointAddress)
                == self._usb.util.ENDPOINT_OUT
            )
            self._control(_RESET, _RESET_ALL)
            self._control(_SET_LATENCY, _LATENCY)
            self.purge()
        except (self._usb.core.USBError, StopIteration, KeyError) as error:
            self.close()
            raise DeviceError(
                f"The FTDI chip {serial} cannot be used ({error}). Another program may be using "
                "it, or you may lack permission."
            ) from error

    def write(self, data: bytes) -> None:
        """Write all of the data.

        Raises:
            DeviceError: The chip is gone or accepts no data.
        """
        try:
            count = self._endpoint.write(data, timeout=round(WRITE_TIMEOUT * 1e3))
        except self._usb.core.USBError as error:
            raise DeviceError(f"The FTDI chip {self._serial} accepts no data ({error}).") from error
        if count != len(data):
            raise DeviceError(
                f"The FTDI chip {self._serial} accepted only {count} of {len(data)} bytes."
            )

    def purge(self) -> None:
        """Discard the chip's buffers in both directions.

        Raises:
            DeviceError: The chip is gone.
        """
        try:
            self._control(_RESET, _PURGE_RECEIVED)
            self._control(_RESET, _PURGE_SENT)
        except self._usb.core.USBError as error:
            raise DeviceError(f"The FTDI chip {self._serial} is gone ({error}).") from error

    def close(self) -> None:
        """Release the chip; raises no errors."""
        with contextlib.suppress(self._usb.core.USBError, NotImplementedError):
            self._usb.util.dispose_resources(self._chip)

    def _control(self, request: int, value: int) -> None:
        # The index 1 selects the chip's first port.
        self._chip.ctrl_transfer(_OUT, request, value, 1, None, round(WRITE_TIMEOUT * 1e3))
