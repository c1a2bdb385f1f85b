# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark scenes: clay in contact with a moving tool, at several sizes.

A case is warmed up, then timed frame by frame, and reports its error at the end.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005
GRAVITY = 9.81
FRAME = 1.0 / 60.0
RADIUS = 0.012
"""Radius of the pressing ball [m]."""


@dataclass(frozen=True)
class Error:
    """The error of a case."""

    figure: str
    """Name of the measured quantity."""
    measured: float
    """Measured value."""
    expected: tuple[float, float]
    """Range in which it should lie."""

    @property
    def error(self) -> float:
        """Distance from the range, relative to its middle; absolute if that is 0."""
        low, high = self.expected
        return max(low - self.measured, self.measured - high, 0.0) / (0.5 * (low + high) or 1.0)


@dataclass
class Run:
    """A case ready to run."""

    solver: Solver
    """Its solver."""
    drive: Callable[[int], None]
    """Move the tools to their poses at the end of a frame, counted from 0."""
    frames: int
    """Number of timed frames."""
    judge: Callable[[], Error]
    """Return the error after all frames."""
    after: Callable[[int], None] = lambda frame: None
    """Take measurements after a frame, untimed."""


@dataclass(frozen=True)
class Case:
    """A scene at one size."""

    name: str
    """Name on the command line."""
    scene: str
    """What happens in it."""
    make: Callable[[Settings, str], Run]
    """Build and warm it up with given settings and device."""
    goal: float = math.nan
    """Target milliseconds per frame on two processor cores."""
    optional: bool = False
    """Whether it is skipped unless requested by name or with all."""
    missing: Callable[[], str] = lambda: ""
    """Why it cannot run here; empty if it can."""


def press_ball(
    counts: tuple[int, int, int], *, warm_up: int = 12, down: int = 8, along: int = 16
) -> Callable[[Settings, str], Run]:
    """A block pressed 12 mm deep by a ball, which then plows along at 0.1 m/s."""

    def make(settings: Settings, device: str) -> Run:
        material = Material()
        scene = Scene(SPACING)
        scene.add_clay(block(counts, SPACING), material)
        scene.add_plane()
        sphere = ball(RADIUS)
        tool = scene.add_mesh(sphere.vertices, sphere.faces)
        top = counts[2] * SPACING + RADIUS
        tool.set_pose(at(0, 0, top + 0.1))
        solver = Solver(scene, settings, device=device)
        solver.begin()
        rest(solver, warm_up)
        tool.set_pose(at(0, 0, top))
        solver.step(FRAME)
        depth = RADIUS
        forces: list[float] = []

        def drive(frame: int) -> None:
            part = min((frame + 1) / down, 1.0)
            tool.set_pose(at(max(frame + 1 - down, 0) * 0.1 * FRAME, 0, top - part * depth))

        def after(frame: int) -> None:
            if down - 2 <= frame < down:
                forces.append(float(solver.force_on(tool)[2]))

        area = math.pi * (2.0 * RADIUS * depth - depth**2)
        # A round punch in a fluid of that viscosity, in addition to slip-line theory.
        speed = depth / (down * FRAME)
        viscous = 8.0 * material.viscosity * math.sqrt(area / math.pi) * speed
        low, high = 5.7 * material.yield_stress * area, 6.05 * material.yield_stress * area
        band = (low + viscous, high + viscous)
        return Run(
            solver,
            drive,
            down + along,
            lambda: Error("force on the ball at full depth [N]", float(np.mean(forces)), band),
            after,
        )

    return make


def rest(solver: Solver, frames: int) -> None:
    """Let clay come to rest and sleep; afterwards everything is compiled and recorded."""
    for _ in range(frames):
        solver.step(FRAME)
        if solver.diagnostics().awake == 0:
            break


def poke(
    counts: tuple[int, int, int], *, warm_up: int, frames: int
) -> Callable[[Settings, str], Run]:
    """A large block at rest, poked by a ball at 0.1 m/s; its weight must stay correct meanwhile."""

    def make(settings: Settings, device: str) -> Run:
        material = Material()
        scene = Scene(SPACING)
        scene.add_clay(block(counts, SPACING), material)
        table = scene.add_plane()
        sphere = ball(RADIUS)
        tool = scene.add_mesh(sphere.vertices, sphere.faces)
        top = counts[2] * SPACING + RADIUS
        tool.set_pose(at(0, 0, top + 0.1))
        solver = Solver(scene, settings, device=device)
        solver.begin()
        rest(solver, warm_up)
        tool.set_pose(at(0, 0, top))
        solver.step(FRAME)
        weight = scene.particle_count * material.density * SPACING**3 * GRAVITY
        ratios: list[float] = []

        def drive(frame: int) -> None:
            tool.set_pose(at(0, 0, top - (frame + 1) * 0.1 * FRAME))

        def after(frame: int) -> None:
            force = -float(solver.force_on(table)[2]) - float(solver.force_on(tool)[2])
            ratios.append(force / weight)

        return Run(
            solver,
            drive,
            frames,
            lambda: Error(
                "force on the table less that of the ball, over m g",
                float(np.mean(ratios)),
                (1.0, 1.0),
            ),
            after,
        )

    return make


WHEEL_COUNT = 4169
"""Number of particles on the wheel of Barreiro et al. 2021."""
WHEEL_RATE = 100.0 * 2.0 * math.pi / 60.0


def dome(count: int) -> NDArray[np.float64]:
    """The ``count`` lattice particles nearest to the middle of a table [m], shape [N, 3]."""
    points = block((31, 31, 16), SPACING)
    order = np.argsort(np.linalg.norm(points * (1.0, 1.0, 1.2), axis=1), kind="stable")
    return points[order[:count]]


def turn_wheel(settings: Settings, device: str) -> Run:
    """A dome of clay on a wheel at 100 rpm, with a ball pressed 4 mm into its side."""
    points = dome(WHEEL_COUNT)
    across = np.hypot(points[:, 0], points[:, 1])
    scene = Scene(SPACING)
    spin = np.cross((0.0, 0.0, WHEEL_RATE), points)
    scene.add_clay(points, Material(friction=1.0), velocities=spin)
    disc = trimesh.creation.cylinder(0.1, 0.02, sections=64)
    # The ball brakes the clay more than any ordinary friction under its weight could withstand.
    wheel = scene.add_mesh(disc.vertices - np.array((0, 0, 0.01)), disc.faces, friction=100.0)
    sphere = ball(RADIUS)
    tool = scene.add_mesh(sphere.vertices, sphere.faces, friction=0.1)
    reach = float(across.max()) + 0.5 * SPACING + RADIUS
    height = 3.0 * SPACING
    tool.set_pose(at(reach + 0.1, 0, height))
    solver = Solver(scene, settings, device=device)
    solver.begin()
    turned = 0

    def turn() -> None:
        nonlocal turned
        turned += 1
        angle = WHEEL_RATE * FRAME * turned
        pose = np.eye(4)
        pose[:2, :2] = (math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))
        wheel.set_pose(pose)

    for _ in range(12):
        turn()
        solver.step(FRAME)
    tool.set_pose(at(reach, 0, height))
    turn()
    solver.step(FRAME)

    def drive(frame: int) -> None:
        turn()
        tool.set_pose(at(reach - min(frame + 1, 16) * 0.00025, 0, height))

    lowest = points[:, 2] < SPACING

    def judge() -> Error:
        x, v = solver.positions()[lowest], solver.velocities()[lowest]
        rate = float(np.cross(x, v)[:, 2].sum() / (x[:, :2] ** 2).sum())
        return Error("turning of the lowest layer over the wheel's", rate / WHEEL_RATE, (1.0, 1.0))

    return Run(solver, drive, 36, judge)


def kindergarten(settings: Settings, device: str) -> Run:
    """The kindergarten scene with its two soft hands, from the moment they touch the clay."""
    import bpy

    from tactile_clay.clay_addon import register
    from tactile_clay.clay_addon.scenes import kindergarten
    from tactile_clay.clay_addon.simulate.simulation import Simulation

    bpy.ops.wm.read_factory_settings(use_empty=True)
    if not hasattr(bpy.types.Object, "tactile_clay"):
        register()
    kindergarten.build(bpy.context)
    simulation = Simulation(bpy.context)
    simulation.settings = settings
    simulation.start(bpy.context.evaluated_depsgraph_get(), device)
    solver = simulation.solver
    assert solver is not None
    number = 1

    def advance() -> None:
        nonlocal number
        number += 1
        bpy.context.scene.frame_set(number)
        simulation.feed(bpy.context.evaluated_depsgraph_get())

    for _ in range(20):
        advance()
        solver.step(FRAME)
    return Run(
        solver,
        lambda frame: advance(),
        70,
        lambda: Error("mean compression", solver.diagnostics().volume_error, (0.0, 0.0)),
    )


def without_blender() -> str:
    """Why the kindergarten cannot be built; empty if it can."""
    return "" if importlib.util.find_spec("bpy") else "it needs Blender, and bpy is missing"


CASES: tuple[Case, ...] = (
    Case("press-2k", "block pressed by a ball", press_ball((13, 13, 13)), 5.0),
    Case("press-4k", "block pressed by a ball", press_ball((16, 16, 16)), 10.0),
    Case("press-20k", "block pressed by a ball", press_ball((27, 27, 27)), 50.0),
    Case("wheel", "dome on a wheel at 100 rpm, a ball pressed 4 mm in", turn_wheel, 10.0),
    Case(
        "kindergarten",
        "kindergarten, two hands",
        kindergarten,
        5.0,
        missing=without_blender,
    ),
    Case(
        "poke-100k",
        "block at rest, poked by a ball",
        poke((50, 50, 40), warm_up=100, frames=12),
        33.0,
    ),
    Case(
        "poke-1m",
        "block at rest, poked by a ball",
        poke((100, 100, 100), warm_up=4, frames=6),
        optional=True,
    ),
)


def chosen(names: Iterable[str], *, everything: bool) -> list[Case]:
    """Cases by name; without names, all but the optional ones.

    Raises:
        ValueError: There is no such case; the message lists all.
    """
    wanted = list(names)
    known = {case.name: case for case in CASES}
    for name in wanted:
        if name not in known:
            raise ValueError(f"There is no case {name!r}. Available: {', '.join(known)}.")
    if wanted:
        return [known[name] for name in wanted]
    return [case for case in CASES if everything or not case.optional]
