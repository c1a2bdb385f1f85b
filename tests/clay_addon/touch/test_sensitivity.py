# SPDX-License-Identifier: GPL-3.0-or-later
"""The color attribute that shows the sensitivity of a hand."""

from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.hands.hand import hand_objects
from tactile_clay.clay_addon.touch.sensitivity import LAYER, sensitivity_colors


def test_fingertips_are_brightest_and_the_palm_is_dark(studio: Any) -> None:
    """Color every vertex of a moved hand, the finger pads brightest and the wrist darkest."""
    studio.scene.tactile_clay.spacing = 0.02
    assert bpy.ops.clay.hand_add(side="RIGHT") == {"FINISHED"}
    (item,) = hand_objects(studio.scene)
    item.parent.location.x += 0.3
    bpy.context.view_layer.update()
    assert bpy.ops.clay.touch_sensitivity() == {"FINISHED"}
    layer = item.data.color_attributes[LAYER]
    assert item.data.color_attributes.active_color == layer
    colors = np.empty(4 * len(layer.data), np.float32)
    layer.data.foreach_get("color", colors)
    brightness = colors.reshape(-1, 4)[:, :3].sum(1)
    places = np.array([tuple(vertex.co) for vertex in item.data.vertices])
    along = places[:, np.ptp(places, axis=0).argmax()]
    if abs(along.max()) < abs(along.min()):
        along = -along
    tips, wrist = along > along.max() - 0.015, along < along.min() + 0.03
    assert brightness[tips].max() == pytest.approx(2.25, abs=0.05)
    assert brightness[wrist].max() < 0.7 * brightness[tips].mean()


def test_the_button_is_disabled_without_a_hand(studio: Any) -> None:
    """Gray out the button."""
    assert not bpy.ops.clay.touch_sensitivity.poll()


def test_brightness_increases_with_the_weight() -> None:
    """Go from dark to bright, always opaque."""
    colors = sensitivity_colors(np.linspace(0.0, 1.0, 20))
    assert (np.diff(colors[:, :3].sum(1)) > 0).all()
    assert (colors[:, 3] == 1.0).all()
