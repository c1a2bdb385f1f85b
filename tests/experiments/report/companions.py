# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of the report from separate modules: hard cases, surfaces, hands and others.

Each is run if its module exists beside this folder, and omitted otherwise.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import Any

import warp as wp

from tactile_clay.solver.scene.settings import MODELS

PARENT = "tactile_clay.tests.experiments"


def companion(name: str) -> ModuleType | None:
    """Import a module beside this folder; None if it does not exist."""
    full = f"{PARENT}.{name}"
    try:
        return importlib.import_module(full)
    except ModuleNotFoundError as error:
        if error.name != full:
            raise
        return None


@dataclass(frozen=True)
class HardCaseResult:
    """The outcome of a hard case."""

    name: str
    """Name of the case."""
    passed: bool
    """Whether it was survived."""
    figures: dict[str, Any]
    """The fields of its result."""
    failure: str = ""
    """The exception that it raised; empty if none."""


def hard_cases() -> dict[str, Callable[[], Any]]:
    """The available hard cases by name."""
    module = companion("hard_cases")
    return dict(module.CASES) if module else {}


def run_hard_case(name: str) -> HardCaseResult:
    """Run a hard case; an exception is part of the outcome."""
    wp.config.quiet = True
    try:
        result = hard_cases()[name]()
    except Exception as error:
        return HardCaseResult(name, False, {}, f"{type(error).__name__}: {error}")
    return HardCaseResult(name, result.passed, asdict(result))


def run_ablation(folder: Path) -> list[str]:
    """Drop the block on the incline in every model and variant, and draw the outcomes.

    Returns:
        Lines of Markdown, none without the ablation modules.
    """
    ablation, picture = companion("ablation"), companion("ablation_picture")
    if ablation is None or picture is None:
        return []
    lines = []
    for model in MODELS:
        results = [
            ablation.drop_on_incline(variant, model=model, times=picture.TIMES)
            for variant in ablation.VARIANTS
        ]
        picture.draw_ablation(results, folder / f"ablation_{model}.png")
        lines += [f"Model `{model}`:", "", f"![Ablation of {model}](ablation_{model}.png)", ""]
        shown = [
            field.name for field in fields(results[0]) if field.name not in ("variant", "frames")
        ]
        lines += [f"| variant | {' | '.join(shown)} |", "|---" * (len(shown) + 1) + "|"]
        lines += [
            f"| {r.variant} | {' | '.join(f'{getattr(r, name):.4g}' for name in shown)} |"
            for r in results
        ]
        lines.append("")
    return lines


def run_touch(folder: Path) -> list[str]:
    """Render touch and judge drives, and draw the results.

    Returns:
        Lines of Markdown, none without the module.
    """
    touch = companion("touch_report")
    return list(touch.run_touch(folder)) if touch else []


def measure_surfaces() -> list[str]:
    """Measure the distance of surfaces from the filled shapes.

    Returns:
        Lines of Markdown, none without the module.
    """
    surfaces = companion("surface_accuracy")
    return list(surfaces.surface_lines()) if surfaces else []


def measure_hands() -> list[str]:
    """Measure the cost of soft hands, and how they press.

    Returns:
        Lines of Markdown, none without the modules.
    """
    cost, press = companion("hand_cost"), companion("hand_press")
    if cost is None or press is None:
        return []
    return [*cost.cost_lines(), "", *press.press_lines(), ""]


def measure_live_surfaces() -> list[str]:
    """Measure the cost and error of surfaces while clay is worked.

    Returns:
        Lines of Markdown, none without the module.
    """
    surface = companion("live_surface")
    if surface is None:
        return []
    return list(surface.surface_lines([surface.measure_surface(size) for size in surface.SIZES]))


def measure_frames() -> list[str]:
    """Measure the breakdown of a live sculpting frame's time.

    Returns:
        Lines of Markdown, none without Blender.
    """
    budget = companion("frame_budget")
    if budget is None or importlib.util.find_spec("bpy") is None:
        return []
    return list(budget.budget_lines())
