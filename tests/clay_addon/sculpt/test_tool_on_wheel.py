# SPDX-License-Identifier: GPL-3.0-or-later
"""A tool held to clay that turns on a wheel."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import SPACING, TICK, Mouse

RADIUS, LAYERS = 0.03, 6
TOP = 0.5 * LAYERS * SPACING


def turned(angle: float) -> NDArray[np.float64]:
    """The pose of a wheel whose upper side is under the clay."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[2, 3] = -TOP - 0.01
    return pose


@pytest.mark.parametrize("speed", [60.0, 150.0])
@pytest.mark.parametrize("drags", [False, True])
def test_a_finger_holds_its_place_and_depth(speed: float, drags: bool) -> None:
    """In the room, while the clay, which is not round, turns under it; and moves on smoothly."""
    mouse = Mouse()
    mouse.source.set(tool="FINGER", strength=0.5, radius=0.012)
    axis = (np.arange(-8, 9) + 0.3) * SPACING
    height = (np.arange(LAYERS) + 0.5) * SPACING - TOP
    points = np.stack(np.meshgrid(axis, axis, height, indexing="ij"), -1).reshape(-1, 3)
    points = points[np.hypot(points[:, 0], points[:, 1]) < RADIUS]
    mouse.clay = points.astype(np.float32)
    scene = Scene(spacing=SPACING)
    scene.add_clay(points, Material.preset("throwing_clay"))
    disc = trimesh.creation.cylinder(0.06, 0.02, sections=48)
    wheel = scene.add_mesh(disc.vertices, disc.faces, friction=0.8, adhesion=20_000.0)
    wheel.set_pose(turned(0.0))
    (tool,) = [scene.add_mesh(mesh.vertices, mesh.faces) for mesh in mouse.brush.meshes()]
    tool.set_enabled(False)
    solver = Solver(scene)
    mouse.at = mouse.pixel(0.018, 0.0, TOP)
    mouse.send("MOUSEMOVE", "NOTHING")
    mouse.send("LEFTMOUSE")
    tips = []
    for tick in range(120):
        if drags:
            mouse.at = mouse.pixel(0.018 - 1e-4 * tick, 0.0, TOP)
            mouse.send("MOUSEMOVE", "NOTHING")
        ((pose, felt),) = mouse.brush.poses(TICK, mouse.clay)
        tool.set_pose(pose)
        tool.set_enabled(felt)
        wheel.set_pose(turned(speed / 60.0 * 2.0 * np.pi * tick * TICK))
        solver.step(TICK)
        mouse.clay = solver.positions()
        if felt:
            tips.append(pose[:3, 3])
    held = np.array(tips)[40:] / SPACING
    assert np.ptp(held[:, 2]) < 0.05
    assert np.ptp(held[:, 1]) < 0.2
    if not drags:
        assert np.ptp(held[:, 0]) < 0.05
    # Chatter would be a change of speed from tick to tick.
    assert np.abs(np.diff(held, 2, axis=0)).max() < 0.25
    away = np.hypot(mouse.clay[:, 0], mouse.clay[:, 1])
    assert away.max() < RADIUS + 3.0 * SPACING
