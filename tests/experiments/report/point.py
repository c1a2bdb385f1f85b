# SPDX-License-Identifier: GPL-3.0-or-later
"""One run of an experiment at a setting and a spacing, with its figures and cost."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np
import warp as wp

from tactile_clay.solver import Settings
from tactile_clay.tests.experiments.standing import stand

from .figure import Measurement
from .meter import TooExpensiveError, metered
from .registry import find

TIME_LIMIT = 90.0
"""Processor time after which an experiment is aborted [s]."""


@dataclass(frozen=True)
class Point:
    """A run of an experiment."""

    experiment: str
    """Name of the experiment."""
    settings: Settings
    """Solver settings."""
    spacing: float
    """Particle spacing [m]."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run."""

    point: Point
    """The run."""
    measurements: tuple[Measurement, ...]
    """Measured figures."""
    core_ms: float
    """Processor milliseconds per frame of 1/60 s."""
    microseconds: float
    """Processor microseconds per particle and frame."""
    failure: str = ""
    """Why it failed; empty if it did not."""

    @property
    def score(self) -> float:
        """The worst score of all figures."""
        return max(m.score for m in self.measurements)

    @property
    def median_score(self) -> float:
        """The median score of all figures."""
        return statistics.median(m.score for m in self.measurements)

    def as_dict(self) -> dict[str, Any]:
        """All values as a dictionary, for JSON."""
        return {
            "experiment": self.point.experiment,
            "settings": asdict(self.point.settings),
            "spacing": self.point.spacing,
            "core_ms_per_frame": self.core_ms,
            "microseconds_per_particle_and_frame": self.microseconds,
            "score": self.score,
            "figures": [
                {
                    "figure": m.figure,
                    "unit": m.unit,
                    "measured": m.value,
                    "reference": [m.low, m.high],
                    "tolerance": m.tolerance,
                    "error": m.error,
                    "score": m.score,
                }
                for m in self.measurements
            ],
            "failure": self.failure,
        }


def run_point(point: Point) -> Outcome:
    """Run an experiment; one that fails has infinite errors."""
    experiment = find(point.experiment)
    failure = ""
    measurements: tuple[Measurement, ...]
    with metered(TIME_LIMIT) as meter, np.errstate(all="ignore"):
        try:
            result = experiment.run(point.settings, point.spacing)
            measurements = tuple(figure.measure(result) for figure in experiment.figures)
        except (TooExpensiveError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            failure = str(error)
            measurements = tuple(figure.missing() for figure in experiment.figures)
    return Outcome(point, measurements, meter.core_ms, meter.microseconds, failure)


def warm_up() -> None:
    """Load and compile what experiments need, so that it does not count as the first one's cost."""
    wp.config.quiet = True
    stand(duration=0.2, settle=0.1)
    run_point(Point("press, 5 kPa, small ball", Settings(substeps=1, iterations=1), 0.01))


def workers(count: int) -> ProcessPoolExecutor:
    """Worker processes for what is not timed."""
    return ProcessPoolExecutor(count, get_context("spawn"), initializer=warm_up)


def run_points(points: Iterable[Point]) -> Iterator[Outcome]:
    """Run points one at a time, so that their cost is correct."""
    for point in points:
        yield run_point(point)
