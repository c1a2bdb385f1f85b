# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings to run the experiments at, and what they come to over all of them."""

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
MOST_WORK = 64
"""Substeps times iterations are not swept beyond this."""
FEW = ((2, 2), (2, 4), (4, 4), (4, 8), (8, 8))
"""Substeps and iterations at other spacings and for other models."""

T = TypeVar("T")


def swept_settings() -> list[Settings]:
    """The default model over substeps and iterations."""
    return [
        replace(Settings(), substeps=substeps, iterations=iterations)
        for substeps in SUBSTEPS
        for iterations in ITERATIONS
        if substeps * iterations <= MOST_WORK
    ]


def few_settings(model: str) -> list[Settings]:
    """A model at a few substeps and iterations."""
    return [
        replace(Settings(), model=model, substeps=substeps, iterations=iterations)
        for substeps, iterations in FEW
    ]


def swept_points(experiments: Iterable[Experiment]) -> list[Point]:
    """All runs of the sweep: settings at the first spacing, a few at the others and per model."""
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
    """As many as tell whether the sweep works."""
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
    """A setting, over all swept experiments at their first spacing."""

    settings: Settings
    """The setting."""
    microseconds: float
    """Processor microseconds a particle and frame: geometric mean over the experiments."""
    worst: float
    """The worst error over its tolerance among all figures."""
    mean: float
    """Mean over all figures of error over tolerance, each taken as 10 at most: what is ten goals
    off is wrong, however far it is, and must not hide the others."""
    met: int
    """Figures within their tolerance."""
    count: int
    """Figures."""


SCORE_LIMIT = 10.0


def combine(outcomes: Sequence[Outcome]) -> list[Combined]:
    """Gather each setting's outcomes; a setting that lacks an experiment is left out."""
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
    """The items (cost, error, what) that no other beats in both; cheapest first."""
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

    Live is the default setting. Film is the cheapest of the front whose mean error is within a
    tenth of the least. Draft is the cheapest of the front whose mean and worst errors are at most
    twice the live setting's.
    """
    if not combined:
        return {}
    edge = [item for _, _, item in front((c.microseconds, c.mean, c) for c in combined)]
    live = next((c for c in combined if c.settings == Settings()), edge[-1])
    film = next(c for c in edge if c.mean <= 1.1 * edge[-1].mean)
    drafts = (c for c in edge if c.mean <= 2.0 * live.mean and c.worst <= 2.0 * live.worst)
    return {"draft": next(drafts, live), "live": live, "film": film}
