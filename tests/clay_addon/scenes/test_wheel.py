# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel scene has the paper's particles, and the wheel carries its clay around."""

from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.hands.hand import hand_message
from tactile_clay.clay_addon.scenes import wheel as wheel_scene
from tactile_clay.clay_addon.simulate.simulation import Simulation
from tactile_clay.clay_addon.wheel.wheel import axle_angle, sample


def test_scene_has_the_particles_of_the_paper(studio: Any) -> None:
    """Fill the lump with 4,169 particles, on a wheel keyed to 100 rpm."""
    built = wheel_scene.build(bpy.context)
    scene = studio.scene
    assert len(built.clay.data.points) == 4169
    assert scene.camera is not None
    assert [hand_message(scene, hand) for hand in built.hands] == ["", ""]
    speeds = []
    for frame in (1, 100, scene.frame_end):
        scene.frame_set(frame)
        speeds.append(built.wheel.tactile_clay.wheel_speed)
    assert speeds == pytest.approx([0.0, 100.0, 0.0], abs=1e-3)
    scene.frame_set(100)
    before = axle_angle(built.wheel)
    scene.frame_set(101)
    expected = 100.0 * 2 * np.pi / 60 / wheel_scene.FRAMES_PER_SECOND
    assert axle_angle(built.wheel) - before == pytest.approx(expected, abs=1e-5)


def test_clay_starts_on_the_wheel_and_turns_with_it(studio: Any) -> None:
    """Carry the lump, which is not quite centered, and lose no clay before hands touch it."""
    built = wheel_scene.build(bpy.context)
    sample(studio.scene)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    simulation.start(bpy.context.evaluated_depsgraph_get(), "cpu")
    first = simulation.positions().astype(np.float64).mean(0)
    for frame in range(2, 17):
        studio.scene.frame_set(frame)
        simulation.feed(bpy.context.evaluated_depsgraph_get())
        simulation.step()
    points = simulation.positions().astype(np.float64)
    angle = axle_angle(built.wheel)
    turned = complex(*first[:2]) * np.exp(1j * angle)
    assert angle > 1.0
    assert points.mean(0)[:2] == pytest.approx([turned.real, turned.imag], abs=1e-4)
    assert np.hypot(*points[:, :2].T).max() < wheel_scene.WHEEL_RADIUS
    assert points[:, 2].min() > 0.0
