# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultrasound arrays, one a file: how each is connected, driven and made silent."""

from __future__ import annotations

import importlib

from .device import Device, DeviceError, DeviceName, Emission, FoundDevice

__all__ = ["Device", "DeviceError", "DeviceName", "Emission", "FoundDevice", "make_device"]

_MAKERS = {
    "simulated": ("simulated", "DeviceSimulated"),
    "sonicsurface": ("sonicsurface", "DeviceSonicSurface"),
    "ultraino": ("ultraino", "choose_board"),
    "openmpd": ("openmpd", "DeviceOpenMPD"),
    "autd3": ("autd3", "DeviceAUTD3"),
    "stratos_explore": ("stratos_explore", "DeviceStratosExplore"),
}
"""Module of each kind, imported only when asked for, and what makes its device."""

DEVICE_KINDS = tuple(_MAKERS)
"""Kinds of device, as the first word of a `DeviceName`."""


def make_device(name: DeviceName | str) -> Device:
    """Make a device, not yet open.

    Args:
        name: As `DeviceName.parse` reads it, such as ``sonicsurface:/dev/ttyUSB0``.

    Raises:
        DeviceError: There is no such kind, or an option is wrong.
    """
    name = DeviceName.parse(name) if isinstance(name, str) else name
    if name.kind not in _MAKERS:
        raise DeviceError(
            f"There is no device {name.kind!r}. There are: {', '.join(DEVICE_KINDS)}."
        )
    module, maker = _MAKERS[name.kind]
    device: Device = getattr(importlib.import_module(f".{module}", __package__), maker)(name)
    return device
