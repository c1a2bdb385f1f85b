# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of a frame of touch on one core: field, foci, route and drive, each with its error."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_clay.haptics import (
    PressureField,
    TransducerArray,
    acoustic_field,
    focus,
    plan_route,
    reconstruct,
    solve_drive,
)
from tactile_clay.tests.experiments.touch import Contacts, misfit
from tactile_clay.tests.haptics.target_sets import random_targets

from .cases import Error

GHOSTS_ALONG = (50, 40)
"""Ghosts along each side of a patch of skin: 2,000 in all."""
SPACING = 0.0022
SIGMA = 0.00865
FRAMES = 200


@dataclass(frozen=True)
class TouchRun:
    """The work of one frame, and its error."""

    work: Callable[[int], None]
    """Do the work of a frame, counted from 0."""
    judge: Callable[[], Error]
    """Return the error after all frames."""
    size: str
    """Size of the problem, in words."""


@dataclass(frozen=True)
class TouchCase:
    """A timed part of touch."""

    name: str
    """Name on the command line."""
    make: Callable[[], TouchRun]
    """Build it."""
    goal: float = math.nan
    """Target milliseconds on one core."""


def skin() -> NDArray[np.float64]:
    """2,000 points on a curved palm 15 cm above an array [m], shape [2000, 3]."""
    x, y = (SPACING * (np.arange(count) - 0.5 * (count - 1)) for count in GHOSTS_ALONG)
    places = np.stack(np.meshgrid(x, y, [0.15], indexing="ij"), -1).reshape(-1, 3)
    places[:, 2] += 0.01 * np.sin(places[:, 0] / 0.03) + 0.005 * np.cos(places[:, 1] / 0.02)
    return places


def load(points: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
    """Pressure at points, with a peak that moves 1.3 mm per frame [Pa], shape [G]."""
    angle = 2.0 * np.pi * frame / 75.0
    away = np.hypot(points[:, 0] - 0.015 * np.cos(angle), points[:, 1] - 0.015 * np.sin(angle))
    return np.asarray(600.0 * np.exp(-0.5 * (away / 0.03) ** 2))


def make_field() -> TouchRun:
    """From contact forces on 2,000 ghosts to the smoothed field."""
    points = skin()
    areas = np.full(len(points), SPACING**2)
    normals = np.tile((0.0, 0.0, -1.0), (len(points), 1))
    state: list[PressureField | None] = [None]
    kept: list[float] = []

    def work(frame: int) -> None:
        forces = -(40.0 * load(points, frame) * areas)[:, None] * normals
        contacts = Contacts(points, normals, areas, forces)
        previous, dt = state[0], None if state[0] is None else 1e3
        field = PressureField.from_contacts(contacts, (0, 0, 0), previous=previous, dt=dt)
        lifted = float(np.abs(forces[:, 2]).sum())
        kept.append(float(field.contact_pressures @ field.areas) / lifted)
        state[0] = field

    return TouchRun(
        work,
        lambda: Error("force kept by smoothing, over the force", float(np.mean(kept)), (1.0, 1.0)),
        "2,000 ghosts",
    )


def make_focus() -> TouchRun:
    """Eight foci for 2,000 touched points, warm-started from the previous frame."""
    points = skin()
    even = np.ones(len(points))
    state: list[Any] = [None]
    ratios: list[float] = []

    def work(frame: int) -> None:
        state[0] = focus(points, load(points, frame), even, sigma=SIGMA, count=8, previous=state[0])

    def judge() -> Error:
        for frame in range(0, FRAMES, 20):
            wanted = load(points, frame)
            warm = None
            for last in range(max(frame - 10, 0), frame + 1):
                warm = focus(points, load(points, last), even, sigma=SIGMA, previous=warm)
            assert warm is not None
            cold = focus(points, wanted, even, sigma=SIGMA)
            errors = [misfit(reconstruct(f, points), wanted, even).error for f in (warm, cold)]
            ratios.append(errors[0] / errors[1])
        figure = "misfit of warm-started foci over that of foci found anew"
        return Error(figure, float(np.mean(ratios)), (0.0, 1.0))

    return TouchRun(work, judge, "2,000 ghosts, 8 foci")


def make_route() -> TouchRun:
    """A route over 2,000 touched points, warm-started from the previous frame."""
    points = skin()
    even = np.ones(len(points))
    state: list[Any] = [None]
    wanted: list[NDArray[np.float64]] = []

    def work(frame: int) -> None:
        wanted.append(load(points, frame))
        state[0] = plan_route(points, wanted[-1], even, sigma=SIGMA, previous=state[0])

    def judge() -> Error:
        found = misfit(state[0].time_average(points), wanted[-1], even).shape_error
        return Error("misfit of the time average's shape", found, (0.0, 0.0))

    return TouchRun(work, judge, "2,000 ghosts")


def make_drive(preset: str) -> Callable[[], TouchRun]:
    """A drive for eight foci."""

    def make() -> TouchRun:
        array = TransducerArray.preset(preset)
        targets = random_targets(FRAMES, fewest=8, most=8)
        ratios: list[NDArray[np.float64]] = []
        drives: list[NDArray[np.complex128]] = []

        def work(frame: int) -> None:
            drives.append(solve_drive(array, *targets[frame]))

        def judge() -> Error:
            for (points, pressures), drive in zip(targets, drives, strict=True):
                ratios.append(np.abs(acoustic_field(array, drive, points)) / pressures)
            spread = float(np.concatenate(ratios).std())
            return Error("spread of achieved over wanted pressure", spread, (0.0, 0.0))

        return TouchRun(work, judge, f"{array.count} transducers, 8 foci")

    return make


CASES: tuple[TouchCase, ...] = (
    TouchCase("touch-field", make_field),
    TouchCase("touch-focus", make_focus, 0.5),
    TouchCase("touch-route", make_route),
    TouchCase("touch-drive", make_drive("stratos_explore"), 1.0),
    TouchCase("touch-drive-on-off", make_drive("sonicsurface"), 1.0),
)


def measure(case: TouchCase, *, frames: int = FRAMES) -> dict[str, Any]:
    """Run a case.

    Returns:
        Its entry in bench.json.
    """
    run = case.make()
    wall, cores = [], []
    for frame in range(frames):
        begin, busy = time.perf_counter(), time.process_time()
        run.work(frame)
        wall.append(1e3 * (time.perf_counter() - begin))
        cores.append(1e3 * (time.process_time() - busy))
    error = run.judge()
    return {
        "case": case.name,
        "size": run.size,
        "frames": frames,
        "ms_median": float(np.median(wall)),
        "ms_p90": float(np.percentile(wall, 90)),
        "core_ms": float(np.median(cores)),
        "goal_ms": None if math.isnan(case.goal) else case.goal,
        "error": {**asdict(error), "error": error.error},
    }


def sentence(figures: dict[str, Any]) -> str:
    """One line about a case."""
    goal = "" if figures["goal_ms"] is None else f", goal {figures['goal_ms']:g}"
    return (
        f"{figures['case']:>18}  {figures['size']}  {figures['ms_median']:.3f} ms per frame "
        f"(p90 {figures['ms_p90']:.3f}{goal})  {figures['core_ms']:.3f} core-ms  "
        f"{figures['error']['figure']}: {figures['error']['measured']:.4g}"
    )
