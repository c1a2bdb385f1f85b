# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects of the tools on simulated clay: a small block on a table, worked by a brush."""

from typing import Any

import numpy as np
import pytest

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import SPACING, TICK, Mouse


class Bench:
    """A block of clay of 80 × 50 × 30 mm, and a brush with a tool."""

    def __init__(self, tool: str, **settings: Any) -> None:
        self.mouse = Mouse()
        self.mouse.source.set(tool=tool, **settings)
        axes = [(np.arange(n) - 0.5 * (n - 1)) * SPACING for n in (16, 10, 6)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        self.mouse.clay = points.astype(np.float32)
        self.top = 0.015
        scene = Scene(spacing=SPACING)
        scene.add_clay(points, Material.preset("plasticine"))
        scene.add_plane((0, 0, -self.top), (0, 0, 1), friction=0.5)
        self.colliders = []
        for mesh in self.mouse.brush.meshes():
            collider = scene.add_mesh(mesh.vertices, mesh.faces, friction=mesh.friction)
            collider.set_enabled(False)
            self.colliders.append(collider)
        self.solver = Solver(scene)

    def ticks(self, count: int) -> None:
        """Simulate some ticks of a session."""
        for _ in range(count):
            poses = self.mouse.brush.poses(TICK, self.mouse.clay)
            for collider, (pose, enabled) in zip(self.colliders, poses, strict=True):
                collider.set_pose(pose)
                collider.set_enabled(enabled)
            self.solver.step(TICK)
            self.mouse.clay = self.solver.positions()

    def stroke(self, *way: tuple[float, float], ticks: int = 25) -> None:
        """Press, drag and release the mouse."""
        for number, place in enumerate(way):
            self.mouse.at = self.mouse.pixel(*place, self.top)
            self.mouse.send("MOUSEMOVE", "NOTHING")
            if number == 0:
                self.mouse.send("LEFTMOUSE")
            self.ticks(ticks)
        self.mouse.send("LEFTMOUSE", "RELEASE")
        self.ticks(25)
        assert not self.mouse.brush.stroking

    def height(self, x: float, y: float, radius: float = 0.004) -> float:
        """Height of the clay at a point of the table [m]."""
        away = np.linalg.norm(self.mouse.clay[:, :2] - np.array((x, y)), axis=1)
        return float(self.mouse.clay[away < radius, 2].max()) + 0.5 * SPACING


def test_depth_of_a_dent_follows_the_strength() -> None:
    """Dent by strength times radius within half a spacing, and nowhere else."""
    bench = Bench("BALL", strength=0.5, radius=0.016)
    bench.stroke((-0.015, 0.0))
    assert bench.height(-0.015, 0.0) == pytest.approx(0.015 - 0.008, abs=0.5 * SPACING)
    assert bench.height(0.03, 0.0) == pytest.approx(0.015, abs=0.1 * SPACING)


def test_a_wire_cuts_the_block() -> None:
    """Cut the block in two with a wire, without pushing the pieces away."""
    bench = Bench("WIRE")
    before = bench.mouse.clay.copy()
    bench.stroke((0.0, -0.05), (0.0, 0.05))
    clay = bench.mouse.clay
    left = before[:, 0] < 0.0
    gap = clay[~left, 0].min() - clay[left, 0].max()
    assert gap > 1.2 * SPACING
    assert np.linalg.norm(clay - before, axis=1).max() < 2.5 * SPACING


def test_a_knife_cuts_and_does_not_push() -> None:
    """Cut a slit into a light, loose block, and leave the block in place."""
    bench = Bench("KNIFE", strength=0.5)
    before = bench.mouse.clay.copy()
    bench.stroke((0.0, -0.04), (0.0, -0.03), (0.0, 0.05))
    clay = bench.mouse.clay
    assert np.linalg.norm(clay - before, axis=1).max() < 4.0 * SPACING
    assert np.linalg.norm(clay.mean(0) - before.mean(0)) < 0.5 * SPACING
    # Half as deep as the block is high: the middle of the upper half is open.
    high = (clay[:, 2] > 0.004) & (np.abs(clay[:, 1]) < 0.02)
    assert np.abs(clay[high, 0]).min() > 0.35 * SPACING


UNEVEN = {
    "ridges across": lambda top: top[np.floor(top[:, 0] / SPACING).astype(int) % 4 < 2],
    "ridges along": lambda top: top[np.floor(top[:, 1] / SPACING).astype(int) % 4 < 2],
    "a ridge": lambda top: top[np.abs(top[:, 0]) < 1.1 * SPACING],
    "a bump": lambda top: top[np.linalg.norm(top[:, :2], axis=1) < 0.006],
    "nothing": lambda top: top[:0],
}
"""Which particles of the block's upper layer have one more above them."""


def smoothing_bench(uneven: str, material: str, radius: float) -> Bench:
    """A brush that smooths, and a block whose upper side is uneven."""
    bench = Bench("SMOOTH", strength=0.5, radius=radius)
    top = bench.mouse.clay[bench.mouse.clay[:, 2] > 0.01]
    more = UNEVEN[uneven](top) + np.array((0.0, 0.0, SPACING), np.float32)
    points = np.concatenate((bench.mouse.clay, more))
    scene = Scene(spacing=SPACING)
    scene.add_clay(points, Material.preset(material))
    scene.add_plane((0, 0, -bench.top), (0, 0, 1), friction=0.5)
    bench.colliders = [
        scene.add_mesh(mesh.vertices, mesh.faces, friction=mesh.friction)
        for mesh in bench.mouse.brush.meshes()
    ]
    bench.colliders[0].set_enabled(False)
    bench.solver = Solver(scene)
    bench.mouse.clay = points
    return bench


def relief(bench: Bench) -> Any:
    """Heights of the middle of the upper side, in spacings."""
    places = [
        (x, y) for x in np.arange(-0.02, 0.0201, 0.0025) for y in np.arange(-0.01, 0.0101, 0.0025)
    ]
    return np.array([bench.height(*place) for place in places]) / SPACING


@pytest.mark.parametrize("radius", [0.015, 0.02])
@pytest.mark.parametrize("material", ["plasticine", "wet_clay"])
@pytest.mark.parametrize("uneven", list(UNEVEN))
def test_smoothing_lowers_what_is_uneven_and_leaves_no_mark(
    uneven: str, material: str, radius: float
) -> None:
    """Each pair of strokes evens the surface; a flat one stays; the clay keeps its volume."""
    bench = smoothing_bench(uneven, material, radius)
    before = relief(bench)
    for y in (0.0, -0.008, 0.008):
        bench.stroke((-0.024, y), (0.024, y), (-0.024, y))
    after = relief(bench)
    if uneven == "nothing":
        assert np.ptp(after) < 0.1
        assert abs(after.mean() - before.mean()) < 0.05
    else:
        assert after.std() < 0.6 * before.std()
        assert after.min() > before.min() - 0.9
    assert abs(bench.solver.diagnostics().volume_error) < 0.01


def test_a_pinch_raises_clay() -> None:
    """Pull clay up between two fingers by more than a spacing above the surface."""
    bench = Bench("PINCH", strength=0.7, radius=0.012)
    bench.mouse.at = bench.mouse.pixel(0.0, 0.0, bench.top)
    bench.mouse.send("MOUSEMOVE", "NOTHING")
    bench.mouse.send("LEFTMOUSE")
    bench.ticks(60)
    for _ in range(6):
        bench.mouse.send("WHEELUPMOUSE")
        bench.ticks(5)
    bench.mouse.send("LEFTMOUSE", "RELEASE")
    bench.ticks(30)
    assert bench.mouse.clay[:, 2].max() + 0.5 * SPACING > 0.015 + SPACING
    assert np.isfinite(bench.mouse.clay).all()
