# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings at which experiments are run, and their results over all experiments."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from tactile_clay.solver import Settings
from tactile_clay.solver.scene.settings import MODELS

from .experiment import Experiment
from .point import Outcome, Point
from .registry import EXPERIMENTS

SUBSTEPS = (1, 2, 4, 8, 16)
ITERATIONS = (1, 2, 4, 8, 16)
MAX_WORK = 64
"""Largest product of substeps and iterations in the sweep."""
FEW = ((2, 2), (2, 4), (4, 4), (4, 8), (8, 8))
"""Substeps and iterations at other spacings and with other models."""

T = TypeVar("T")


def swept_settings() -> list[Settings]:
    """The default model at all substeps and iterations."""
    return [
        replace(Settings(), substeps=substeps, iterations=iterations)
        for substeps in SUBSTEPS
        for iterations in ITERATIONS
        if substeps * iterations <= MAX_WORK
    ]


def few_settings(model: str) -> list[Settings]:
    """A model at a few substeps and iterations."""
    return [
        replace(Settings(), model=model, substeps=substeps, iterations=iterations)
        for substeps, iterations in FEW
    ]


def swept_points(experiments: Iterable[Experiment]) -> list[Point]:
    """All runs of the sweep: all settings at the first spacing, a few at others and per model."""
    points: dict[Point, None] = {}
    default = Settings()
    for experiment in experiments:
        first, *others = experiment.spacings
        runs = [(settings, first) for settings in (default, *swept_settings())]
        runs += [(settings, d) for d in others for settings in few_settings(default.model)]
        runs += [
            (settings, first)
            for model in MODELS
            if model != default.model
            for settings in few_settings(model)
        ]
        points |= dict.fromkeys(Point(experiment.name, *run) for run in runs)
    return list(points)


def quick_points(experiments: Iterable[Experiment]) -> list[Point]:
    """Enough runs to test the sweep."""
    settings = [replace(Settings(), substeps=n, iterations=n) for n in (2, 4)]
    return list(
        dict.fromkeys(
            Point(experiment.name, s, experiment.spacings[0])
            for experiment in experiments
            for s in (Settings(), *settings)
        )
    )


@dataclass(frozen=True)
class Combined:
    """A setting's results over all swept experiments at their first spacing."""

    settings: Settings
    """The setting."""
    microseconds: float
    """Processor microseconds per particle and frame: geometric mean over the experiments."""
    worst: float
    """Worst score of all figures."""
    mean: float
    """Mean score of all figures, each taken as at most 10, so that an entirely wrong figure does
    not hide the others."""
    met: int
    """Number of figures within their tolerance."""
    count: int
    """Number of figures."""


SCORE_LIMIT = 10.0


def combine(outcomes: Sequence[Outcome]) -> list[Combined]:
    """Combine each setting's outcomes, omitting settings that lack an experiment."""
    first = {e.name: e.spacings[0] for e in EXPERIMENTS}
    chosen = [o for o in outcomes if o.point.spacing == first[o.point.experiment]]
    names = {o.point.experiment for o in chosen}
    results = []
    for settings in dict.fromkeys(o.point.settings for o in chosen):
        group = [o for o in chosen if o.point.settings == settings]
        if {o.point.experiment for o in group} != names:
            continue
        scores = [m.score for o in group for m in o.measurements]
        results.append(
            Combined(
                settings,
                math.exp(statistics.fmean(math.log(max(o.microseconds, 1e-3)) for o in group)),
                max(scores),
                statistics.fmean(min(score, SCORE_LIMIT) for score in scores),
                sum(score <= 1.0 for score in scores),
                len(scores),
            )
        )
    return results


def front(items: Iterable[tuple[float, float, T]]) -> list[tuple[float, float, T]]:
    """Pareto front of items (cost, error, item), cheapest first."""
    best = math.inf
    kept = []
    for cost, error, item in sorted(items, key=lambda row: row[:2]):
        if error < best:
            best = error
            kept.append((cost, error, item))
    return kept


QUALITIES = ("draft", "live", "film")


def choose_qualities(combined: Sequence[Combined]) -> dict[str, Combined]:
    """Take draft, live and film from the front of cost against mean error.

    Live is the default setting. Film is the cheapest on the front whose mean error is within a
    tenth of the smallest. Draft is the cheapest on the front whose mean and worst errors are at
    most twice the live setting's.
    """
    if not combined:
        return {}
    edge = [item for _, _, item in front((c.microseconds, c.mean, c) for c in combined)]
    live = next((c for c in combined if c.settings == Settings()), edge[-1])
    film = next(c for c in edge if c.mean <= 1.1 * edge[-1].mean)
    drafts = (c for c in edge if c.mean <= 2.0 * live.mean and c.worst <= 2.0 * live.worst)
    return {"draft": next(drafts, live), "live": live, "film": film}
