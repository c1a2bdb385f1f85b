# SPDX-License-Identifier: GPL-3.0-or-later
"""The report: scoring of errors, the front, and complete output."""

import json
import math
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tactile_clay.solver import QUALITIES, Settings
from tactile_clay.tests.experiments.report import registry, stability, sweep
from tactile_clay.tests.experiments.report.figure import Figure
from tactile_clay.tests.experiments.report.meter import TooExpensiveError, metered
from tactile_clay.tests.experiments.report.stability import Behavior, Cell
from tactile_clay.tests.experiments.report.sweep import Combined
from tactile_clay.tests.experiments.standing import stand


@dataclass
class Result:
    """A possible result of an experiment."""

    force: float
    theory: tuple[float, float] = (12.0, 14.0)


@pytest.mark.parametrize(("force", "error"), [(12.5, 0.0), (11.0, 1.0), (15.3, 1.3)])
def test_error_is_the_distance_from_the_band(force: float, error: float):
    """Be zero inside the band, and outside the distance to its nearer end."""
    figure = Figure("force", "force", lambda r: r.theory, 0.1, "N", relative=True)
    measured = figure.measure(Result(force))
    assert measured.error == pytest.approx(error)
    assert measured.score == pytest.approx(error / 1.3)


def test_non_finite_results_have_infinite_error():
    """Score missing results as infinitely wrong."""
    figure = Figure("force", "force", 13.0, 0.1)
    assert math.isinf(figure.measure(Result(math.nan)).error)
    assert math.isinf(figure.missing().score)


def test_front_holds_undominated_items():
    """Keep an item only if everything cheaper is worse."""
    items = [(1.0, 5.0, "a"), (2.0, 6.0, "b"), (3.0, 2.0, "c"), (3.0, 1.0, "d"), (9.0, 1.0, "e")]
    assert [name for _, _, name in sweep.front(items)] == ["a", "d"]


def test_qualities_come_from_the_front():
    """Choose the default as live, a cheap good setting as draft, and a nearly best one as film."""

    def item(substeps: int, cost: float, mean: float, worst: float) -> Combined:
        return Combined(
            settings=replace(Settings(), substeps=substeps),
            microseconds=cost,
            worst=worst,
            mean=mean,
            met=1,
            count=2,
        )

    live = item(Settings().substeps, 4.0, 1.0, 2.0)
    table = [
        item(1, 1.0, 1.9, 40.0),
        item(2, 2.0, 1.8, 3.0),
        live,
        item(6, 5.0, 2.0, 2.0),
        item(8, 8.0, 0.52, 2.0),
        item(16, 16.0, 0.5, 2.0),
    ]
    chosen = sweep.choose_qualities(table)
    assert chosen["live"] is live
    assert chosen["draft"].settings.substeps == 2
    assert chosen["film"].settings.substeps == 8


def test_qualities_are_in_order_of_work():
    """Match the report's names, with live as the default, in order of work per frame."""
    assert tuple(QUALITIES) == sweep.QUALITIES
    assert QUALITIES["live"] == Settings()
    work = [settings.substeps * (settings.iterations or 6) for settings in QUALITIES.values()]
    assert work == sorted(set(work))


def test_margin_ends_at_the_first_cell_that_is_not_stable():
    """Measure how far the map is stable, and whether something unstable bounds it."""
    speed = 0.0
    cells = [
        Cell(n, 1e5, Behavior.STABLE if n > 1 else Behavior.BLOWN_UP, speed, speed)
        for n in (1, 2, 4)
    ]
    cells += [Cell(4, 1e6, Behavior.STABLE, speed, speed)]
    margin = stability.margin(cells, Settings(substeps=4), 1.1e5)
    assert margin.time_step == pytest.approx(2.0)
    assert margin.time_step_bounded
    assert margin.stiffness == pytest.approx(10.0)
    assert not margin.stiffness_bounded


def test_meter_counts_every_step_and_stops_expensive_runs():
    """Count the frames of all solvers made inside, and give up at the limit."""
    with metered(1e3) as meter:
        stand(duration=0.2, settle=0.1, counts=2)
    assert meter.frames == pytest.approx(12 - 4)
    assert meter.particle_frames == pytest.approx(8 * 8)
    assert 0.0 < meter.counted <= meter.spent
    with pytest.raises(TooExpensiveError), metered(1e-9):
        stand(duration=0.2, settle=0.1, counts=2)


def test_names_are_unique_and_all_experiments_can_be_swept():
    """Identify experiments by unique names."""
    names = [experiment.name for experiment in registry.EXPERIMENTS]
    assert len(set(names)) == len(names)
    assert {p.experiment for p in sweep.swept_points(registry.EXPERIMENTS)} == set(names)


def test_quick_report_is_complete(tmp_path: Path):
    """Write the page, its data and every picture that the page shows."""
    module = "tactile_clay.tests.experiments.report"
    subprocess.run([sys.executable, "-m", module, "--quick", "--output", str(tmp_path)], check=True)
    data = json.loads((tmp_path / "report.json").read_text("utf-8"))
    page = (tmp_path / "report.md").read_text("utf-8")
    pictures = ["front.png", "live.png", "experiments.png", "stability.png"]
    for name in pictures:
        assert f"({name})" in page
        assert (tmp_path / name).stat().st_size > 10_000
    assert set(data["qualities"]) == {"draft", "live", "film"}
    assert all(run["core_ms_per_frame"] > 0 for run in data["sweep"])
    assert {cell["behavior"] for cell in data["stability"]["cells"]} <= {
        "stable",
        "jitter",
        "blown up",
    }
