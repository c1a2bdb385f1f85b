# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals call each listener once."""

from typing import Any

import bpy

from tactile_clay.clay_addon.base.signals import (
    SceneSignal,
    held_frames_changed,
    wheels_changed,
)


def test_listeners_are_called_once_in_order_until_disconnected() -> None:
    """Connect twice, disconnect twice, and be called while connected."""
    signal, called = SceneSignal(), []
    first, second = (lambda scene, name=name: called.append(name) for name in ("first", "second"))
    for listener in (first, second, first):
        signal.connect(listener)
    signal.send(bpy.context.scene)
    signal.disconnect(first)
    signal.disconnect(first)
    signal.send(bpy.context.scene)
    assert called == ["first", "second", "second"]


def test_properties_signal_their_changes(studio: Any) -> None:
    """Send a signal when the held frames, a wheel's speed or its phase are set."""
    called: list[str] = []
    clay = studio.clay()
    listeners = {
        held_frames_changed: lambda scene: called.append(f"held {scene.name}"),
        wheels_changed: lambda scene: called.append(f"wheels {scene.name}"),
    }
    for signal, listener in listeners.items():
        signal.connect(listener)
    try:
        studio.scene.tactile_clay.hold_frames = 2
        clay.tactile_clay.wheel_speed = 10.0
        clay.tactile_clay.wheel_phase = 1.0
    finally:
        for signal, listener in listeners.items():
            signal.disconnect(listener)
    name = studio.scene.name
    assert called == [f"held {name}", f"wheels {name}", f"wheels {name}"]
