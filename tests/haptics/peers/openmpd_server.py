# SPDX-License-Identifier: GPL-3.0-or-later
"""An array server whose USB is a pyusb backend connected to an `openmpd_board`.

Its arguments are the board's port, then those of the array server.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core

from tactile_clay.haptics.array_server import command, guard, launch
from tactile_clay.haptics.devices import ftdi_fifo

MODULE = "tactile_clay.tests.haptics.peers.openmpd_server"
SERIAL = "FT6PLAY1"
ENDPOINT_OUT, ENDPOINT_IN = 0x02, 0x81


class BoardBackend(usb.backend.IBackend):  # type: ignore[misc]
    """One FT232H, which passes bulk data and control requests to a board in another process."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._lines = self._socket.makefile("r")

    def _call(self, name: str, **values: Any) -> None:
        self._socket.sendall((json.dumps({"name": name, **values}) + "\n").encode())
        answer = json.loads(self._lines.readline())
        if answer == "gone":
            raise usb.core.USBError("No such device (it may have been disconnected)", -4, 19)
        if answer == "timeout":
            raise usb.core.USBTimeoutError("Operation timed out", -7, 110)

    def enumerate_devices(self) -> Iterator[int]:
        try:
            self._call("look")
        except usb.core.USBError:
            return
        yield 1

    def get_device_descriptor(self, dev: int) -> Any:
        return SimpleNamespace(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x0200,
            bDeviceClass=0,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=0x0403,
            idProduct=0x6014,
            bcdDevice=0x0900,
            iManufacturer=1,
            iProduct=2,
            iSerialNumber=3,
            bNumConfigurations=1,
            address=5,
            bus=1,
            port_number=1,
            port_numbers=(1,),
            speed=3,
        )

    def get_configuration_descriptor(self, dev: int, config: int) -> Any:
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=2,
            wTotalLength=32,
            bNumInterfaces=1,
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0x80,
            bMaxPower=50,
            extra_descriptors=[],
        )

    def get_interface_descriptor(self, dev: int, intf: int, alt: int, config: int) -> Any:
        if intf or alt:
            raise IndexError(intf)
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=4,
            bInterfaceNumber=0,
            bAlternateSetting=0,
            bNumEndpoints=2,
            bInterfaceClass=255,
            bInterfaceSubClass=255,
            bInterfaceProtocol=255,
            iInterface=2,
            extra_descriptors=[],
        )

    def get_endpoint_descriptor(self, dev: int, ep: int, intf: int, alt: int, config: int) -> Any:
        return SimpleNamespace(
            bLength=7,
            bDescriptorType=5,
            bEndpointAddress=(ENDPOINT_IN, ENDPOINT_OUT)[ep],
            bmAttributes=2,
            wMaxPacketSize=512,
            bInterval=0,
            bRefresh=0,
            bSynchAddress=0,
            extra_descriptors=[],
        )

    def open_device(self, dev: int) -> int:
        self._call("open")
        return 1

    def close_device(self, dev_handle: int) -> None:
        pass

    def set_configuration(self, dev_handle: int, config_value: int) -> None:
        self._call("configure")

    def get_configuration(self, dev_handle: int) -> int:
        return 1

    def claim_interface(self, dev_handle: int, intf: int) -> None:
        self._call("claim")

    def release_interface(self, dev_handle: int, intf: int) -> None:
        pass

    def is_kernel_driver_active(self, dev_handle: int, intf: int) -> bool:
        return False

    def bulk_write(self, dev_handle: int, ep: int, intf: int, data: Any, timeout: int) -> int:
        assert ep == ENDPOINT_OUT
        self._call("write", data=bytes(data).hex())
        return len(data)

    def ctrl_transfer(
        self,
        dev_handle: int,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: Any,
        timeout: int,
    ) -> int:
        if request_type == 0x80 and request == 6:
            text = {0: "\x00", 3: SERIAL}.get(value & 0xFF, "board")
            body = b"\x09\x04" if value & 0xFF == 0 else text.encode("utf-16-le")
            described = bytes([len(body) + 2, 3]) + body
            data[: len(described)] = type(data)("B", described[: len(data)])
            return len(described)
        self._call("control", values=[request_type, request, value, index])
        return 0


def main() -> int:
    backend = BoardBackend(int(sys.argv[1]))
    setattr(ftdi_fifo, "find_backend", lambda: backend)  # noqa: B010

    # The guard must use the same board.
    def start_here(part: str, words: Any, *, stdout: Any = None) -> Any:
        import subprocess

        return subprocess.Popen(
            [sys.executable, "-m", MODULE, sys.argv[1], part, *words],
            stdin=subprocess.PIPE,
            stdout=stdout,
            start_new_session=True,
        )

    setattr(guard, "start_process", start_here)  # noqa: B010
    assert launch.start_process is not start_here
    if sys.argv[2] == "guard":
        return guard.main(sys.argv[3:])
    return command.main(sys.argv[2:])


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)
