# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the experiments, and writes their measurements, the theoretical values and the cost.

Writes report.md with its pictures, and report.json, to build/report.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import warp as wp

from tactile_clay.solver import Material, Settings

from . import plots
from .companions import (
    HardCaseResult,
    hard_cases,
    measure_frames,
    measure_hands,
    measure_live_surfaces,
    measure_surfaces,
    run_ablation,
    run_hard_case,
    run_touch,
)
from .page import Report, write_data, write_page
from .point import Outcome, Point, run_point, run_points, warm_up, workers
from .registry import EXPERIMENTS
from .stability import MODULI, SUBSTEPS, Cell, margin, run_cell
from .sweep import choose_qualities, combine, quick_points, swept_points


def machine() -> dict[str, str | int]:
    """Processor, cores and versions."""
    return {
        "processor": platform.machine(),
        "cores": os.cpu_count() or 1,
        "Python": platform.python_version(),
        "Warp": wp.__version__,
    }


def print_progress(text: str) -> None:
    """Print a progress message."""
    print(text, flush=True)


def measure_costs(report: Report, points: list[Point]) -> None:
    """Run the timed experiments one at a time."""
    warm_up()
    begin = time.perf_counter()
    for done, outcome in enumerate(run_points(points), 1):
        report.swept.append(outcome)
        if done % 20 == 0 or done == len(points):
            print_progress(f"  {done} of {len(points)} runs, {time.perf_counter() - begin:.0f} s")


def measure_rest(report: Report, pool: ProcessPoolExecutor, *, quick: bool) -> None:
    """Run two at a time what is not timed: stability, hard cases and unswept experiments."""
    swept = {o.point for o in report.swept}
    live = [Point(e.name, Settings(), e.spacings[0]) for e in EXPERIMENTS if not quick or e.quick]
    experiments: list[Future[Outcome]] = [
        pool.submit(run_point, point) for point in live if point not in swept
    ]
    cases: list[Future[HardCaseResult]] = []
    if not quick:
        cases = [pool.submit(run_hard_case, name) for name in hard_cases()]
    substeps = (2, 4) if quick else SUBSTEPS
    moduli = MODULI[2:9:3] if quick else MODULI
    cells: list[Future[Cell]] = [
        pool.submit(run_cell, n, modulus, Settings()) for n in substeps for modulus in moduli
    ]
    found = {o.point: o for o in (*report.swept, *(job.result() for job in experiments))}
    report.live = [found[point] for point in live]
    report.hard_cases = [job.result() for job in cases]
    report.cells = [job.result() for job in cells]
    report.margin = margin(report.cells, Settings(), Material().shear_modulus)


def draw(report: Report, folder: Path) -> None:
    """Draw the pictures."""
    if report.combined:
        plots.plot_combined(report.combined, report.qualities, folder / "front.png")
    if report.swept:
        plots.plot_experiments(report.swept, folder / "experiments.png")
    plots.plot_scoreboard(report.live, folder / "live.png")
    if report.margin:
        plots.plot_stability(
            report.cells,
            Settings(),
            Material().shear_modulus,
            report.margin,
            folder / "stability.png",
        )


def main() -> None:
    """Run everything and write the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/report"))
    parser.add_argument("--quick", action="store_true", help="only a small part, in about a minute")
    options = parser.parse_args()
    wp.config.quiet = True
    options.output.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    report = Report(machine())
    if options.quick:
        points = quick_points(e for e in EXPERIMENTS if e.quick)
    else:
        points = swept_points(e for e in EXPERIMENTS if e.swept)
    print_progress(f"Timing {len(points)} experiments over settings, one at a time ...")
    measure_costs(report, points)
    report.combined = combine(report.swept)
    report.qualities = choose_qualities(report.combined)
    print_progress("Running other experiments, the stability map and hard cases, two at a time ...")
    with workers(2) as pool:
        measure_rest(report, pool, quick=options.quick)
    if not options.quick:
        print_progress("Measuring soft hands ...")
        report.hands = measure_hands()
        print_progress("Measuring surfaces ...")
        report.live_surfaces = measure_live_surfaces()
        report.surfaces = measure_surfaces()
        print_progress("Measuring a frame of live sculpting ...")
        report.frames = measure_frames()
        report.ablation = run_ablation(options.output)
        print_progress("Running touch ...")
        report.touch = run_touch(options.output)
    report.seconds = time.perf_counter() - begin
    draw(report, options.output)
    write_page(report, options.output)
    write_data(report, options.output)
    print_progress(f"Wrote {options.output / 'report.md'}, its pictures and report.json.")


if __name__ == "__main__":
    main()
