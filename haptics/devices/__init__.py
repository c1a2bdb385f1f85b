# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultrasound devices, one per file: how each is connected, driven and silenced."""

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
"""Module of each kind, imported only when needed, and the class or function that makes a device."""

DEVICE_KINDS = tuple(_MAKERS)
"""Kinds of device: the first part of a `DeviceName`."""


def make_device(name: DeviceName | str) -> Device:
    """Make a device without opening it.

    Args:
        name: A name such as ``sonicsurface:/dev/ttyUSB0``; see `DeviceName`.

    Raises:
        DeviceError: The kind is unknown, or an option is wrong.
    """
    name = DeviceName.parse(name) if isinstance(name, str) else name
    if name.kind not in _MAKERS:
        raise DeviceError(
            f"There is no device {name.kind!r}. There are: {', '.join(DEVICE_KINDS)}."
        )
    module, maker = _MAKERS[name.kind]
    device: Device = getattr(importlib.import_module(f".{module}", __package__), maker)(name)
    return device
