# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's page and its data file."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tactile_clay.solver import Settings

from .companions import HardCaseResult
from .point import TIME_LIMIT, Outcome
from .registry import find
from .stability import EJECTED_SPEED, JITTER_SPEED, Cell, Margin
from .sweep import QUALITIES, SCORE_LIMIT, Combined

ABOUT_ERRORS = f"""\
An error is the distance of a figure from its reference, 0 inside the reference's band: the band has
no width if theory gives one number, and spans the theories if they differ. Divided by the goal set
for the figure, as in the table below, errors can be compared: *1 goal* means that the goal is just
met. An experiment's error is that of its worst figure. The mean over all experiments is taken over
all figures, each counted as at most {SCORE_LIMIT:g} goals, so that an entirely wrong figure does
not hide the others; the worst figure and the number of goals met are listed too.

Cost is the processor time of the solver's steps alone, over all threads, with no other experiment
running, without each solver's first steps. A frame is 1/60 s of simulated time."""


@dataclass
class Report:
    """All results of the report."""

    machine: dict[str, Any]
    """Processor, cores and versions."""
    live: list[Outcome] = field(default_factory=list)
    """Every experiment at the live setting."""
    swept: list[Outcome] = field(default_factory=list)
    """Swept experiments at all settings."""
    combined: list[Combined] = field(default_factory=list)
    """Settings, combined over all swept experiments."""
    qualities: dict[str, Combined] = field(default_factory=dict)
    """Settings for draft, live and film."""
    cells: list[Cell] = field(default_factory=list)
    """The stability map."""
    margin: Margin | None = None
    """Stability margin of the live setting."""
    hard_cases: list[HardCaseResult] = field(default_factory=list)
    """Outcomes of the hard cases."""
    hands: list[str] = field(default_factory=list)
    """Lines of the section about soft hands."""
    live_surfaces: list[str] = field(default_factory=list)
    """Lines of the section about surfaces while clay is worked."""
    ablation: list[str] = field(default_factory=list)
    """Lines of the section about the ablation."""
    surfaces: list[str] = field(default_factory=list)
    """Lines of the section about surfaces."""
    frames: list[str] = field(default_factory=list)
    """Lines of the section about a live frame."""
    touch: list[str] = field(default_factory=list)
    """Lines of the section about touch."""
    seconds: float = 0.0
    """Duration of the report [s]."""


def write_page(report: Report, folder: Path) -> None:
    """Write report.md."""
    lines = ["# Measurements of the clay", ""]
    lines += [" · ".join(f"{k} {v}" for k, v in report.machine.items()), ""]
    live = Settings()
    count = live.iterations or "as many as stiffness requires"
    lines += [
        f"The live setting, `Settings()`: {live.substeps} substeps per frame, iterations per "
        f"substep: {count}, model `{live.model}`.",
        "",
        "## Errors and cost",
        "",
        ABOUT_ERRORS,
        "",
    ]
    if report.combined:
        lines += ["![Mean error against cost](front.png)", ""]
        lines += _quality_table(report)
    lines += ["## The live setting", "", "![Errors at the live setting](live.png)", ""]
    lines += _live_table(report)
    if report.swept:
        lines += ["## Error against cost, by experiment", ""]
        lines += ["![Worst error of each experiment against its cost](experiments.png)", ""]
        lines += _spacing_table(report.swept)
    if report.cells:
        lines += ["## Stability", "", "![Substep against stiffness](stability.png)", ""]
        lines += [
            "A block is pressed by a ball, released, and left alone for half a second. It is "
            "*stable* if its root-mean-square speed is then below "
            f"{1e3 * JITTER_SPEED:g} mm/s (the number in the cell), else it *jitters*; it has "
            f"*blown up* if a particle was ever faster than {EJECTED_SPEED:g} m/s (the number in "
            "the cell), had to be slowed or was not finite.",
            "",
        ]
    if report.hands:
        lines += ["## Soft hands", "", *report.hands, ""]
    if report.live_surfaces:
        lines += ["## Surfaces while clay is worked", "", *report.live_surfaces, ""]
    if report.frames:
        lines += ["## A frame of live sculpting", "", *report.frames]
    if report.ablation:
        lines += ["## Ablation", "", *report.ablation, ""]
    if report.surfaces:
        lines += ["## Surfaces", "", *report.surfaces, ""]
    if report.touch:
        lines += ["## Touch", "", *report.touch]
    if report.hard_cases:
        lines += ["## Hard cases", "", *_hard_case_table(report.hard_cases)]
    lines += [f"Made in {report.seconds / 60.0:.1f} minutes."]
    (folder / "report.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _quality_table(report: Report) -> list[str]:
    lines = [
        "*Live* is the default. *Film* is the cheapest setting on the front whose mean error is "
        "within a tenth of the smallest. *Draft* is the cheapest on the front whose mean and worst "
        "errors are at most twice those of live.",
        "",
        "| quality | substeps × iterations | µs per particle and frame | mean error, goals "
        "| worst error, goals | goals met |",
        "|---|---|---|---|---|---|",
    ]
    for name in QUALITIES:
        if name in report.qualities:
            c = report.qualities[name]
            lines.append(
                f"| {name} | {c.settings.substeps} × {c.settings.iterations or 'auto'} "
                f"| {c.microseconds:.1f} | {c.mean:.2f} | {_number(c.worst)} "
                f"| {c.met} of {c.count} |"
            )
    return [*lines, ""]


def _live_table(report: Report) -> list[str]:
    outcomes = report.live
    timed = {o.point for o in report.swept}
    lines = [
        "| experiment | figure | measured | reference | goal: within | error, goals "
        "| core-ms per frame |",
        "|---|---|---|---|---|---|---|",
    ]
    for outcome in outcomes:
        name = outcome.point.experiment
        # The others ran two at a time.
        cost = f"{outcome.core_ms:.1f}" if outcome.point in timed else ""
        for m in outcome.measurements:
            mark = "" if m.score <= 1.0 else " ✗"
            unit = f" {m.unit}" if m.unit else ""
            lines.append(
                f"| {name} | {m.figure} | {m.value:.4g}{unit} | {m.reference_text()}{unit} "
                f"| {m.tolerance:.2g}{unit} | {_number(m.score)}{mark} | {cost} |"
            )
            name = cost = ""
        if outcome.failure:
            lines.append(f"| | {outcome.failure} | | | | | |")
    lines += ["", "References:", ""]
    sources: dict[str, list[str]] = {}
    for outcome in outcomes:
        name = outcome.point.experiment
        sources.setdefault(find(name).source, []).append(name)
    lines += [f"- {'; '.join(names)}: {source}." for source, names in sources.items()]
    return [*lines, ""]


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "no result"
    return f"{value:.2f}" if value >= 0.005 else "0.00"


def _spacing_table(outcomes: Sequence[Outcome]) -> list[str]:
    live = [o for o in outcomes if o.point.settings == Settings()]
    finer = {o.point.experiment for o in outcomes if o.point.spacing != _first(o)}
    if not finer:
        return []
    lines = [
        "At other spacings, at the live setting; figures in the order of the table above:",
        "",
        "| experiment | spacing | measured | core-ms per frame |",
        "|---|---|---|---|",
    ]
    for o in sorted(live, key=lambda o: o.point.spacing):
        if o.point.experiment in finer:
            figures = ", ".join(f"{m.figure} {m.value:.3g}" for m in o.measurements)
            lines.append(
                f"| {o.point.experiment} | {1e3 * o.point.spacing:g} mm | {figures} "
                f"| {o.core_ms:.1f} |"
            )
    return [*lines, ""]


def _first(outcome: Outcome) -> float:
    return find(outcome.point.experiment).spacings[0]


def _hard_case_table(cases: Sequence[HardCaseResult]) -> list[str]:
    names = list(dict.fromkeys(name for case in cases for name in case.figures))
    titles = [name.replace("_", " ") for name in names]
    lines = [f"| case | survived | {' | '.join(titles)} |", "|---" * (len(names) + 2) + "|"]
    for case in cases:
        cells = [_shown(case.figures[name]) for name in names if name in case.figures]
        if case.failure:
            cells = [case.failure] + [""] * (len(names) - 1)
        survived = "yes" if case.passed else "**no**"
        lines.append(f"| {case.name} | {survived} | {' | '.join(cells)} |")
    passed = sum(case.passed for case in cases)
    return [f"{passed} of {len(cases)} cases are survived.", "", *lines, ""]


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def write_data(report: Report, folder: Path) -> None:
    """Write report.json, with numbers that are not finite as null."""
    data = {
        "machine": report.machine,
        "seconds": report.seconds,
        "time_limit_per_experiment": TIME_LIMIT,
        "live": [o.as_dict() for o in report.live],
        "sweep": [o.as_dict() for o in report.swept],
        "combined": [asdict(c) for c in report.combined],
        "qualities": {name: asdict(c) for name, c in report.qualities.items()},
        "stability": {
            "cells": [asdict(c) | {"behavior": c.behavior.value} for c in report.cells],
            "margin": asdict(report.margin) if report.margin else None,
        },
        "hard_cases": [asdict(case) for case in report.hard_cases],
    }
    text = json.dumps(_finite(data), indent=1, allow_nan=False)
    (folder / "report.json").write_text(text + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, float) or hasattr(value, "dtype"):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
