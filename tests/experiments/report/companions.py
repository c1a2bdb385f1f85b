# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of the report that modules of their own bring: hard cases, surfaces, hands and others.

Each is run where its module stands beside this folder, and left out where it does not.
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
    """Import a module beside this folder, if it is there."""
    full = f"{PARENT}.{name}"
    try:
        return importlib.import_module(full)
    except ModuleNotFoundError as error:
        if error.name != full:
            raise
        return None


@dataclass(frozen=True)
class HardCaseResult:
    """What happened in a hard case."""

    name: str
    """Its name."""
    passed: bool
    """Whether it was survived."""
    figures: dict[str, Any]
    """The fields of its result."""
    failure: str = ""
    """What it raised, empty where nothing."""


def hard_cases() -> dict[str, Callable[[], Any]]:
    """The hard cases there are, by name."""
    module = companion("hard_cases")
    return dict(module.CASES) if module else {}


def run_hard_case(name: str) -> HardCaseResult:
    """Run one; what it raises is part of what happened."""
    wp.config.quiet = True
    try:
        result = hard_cases()[name]()
    except Exception as error:
        return HardCaseResult(name, False, {}, f"{type(error).__name__}: {error}")
    return HardCaseResult(name, result.passed, asdict(result))


def run_ablation(folder: Path) -> list[str]:
    """Drop the block on the incline in every model and variant, and draw what became of it.

    Returns:
        Lines of Markdown, none where there is no ablation.
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
    """Render touch and judge drives, and draw what came out.

    Returns:
        Lines of Markdown, none where there is no such module.
    """
    touch = companion("touch_report")
    return list(touch.run_touch(folder)) if touch else []


def measure_surfaces() -> list[str]:
    """Measure how far surfaces are from the shapes that were filled.

    Returns:
        Lines of Markdown, none where there is no such module.
    """
    surfaces = companion("surface_accuracy")
    return list(surfaces.surface_lines()) if surfaces else []


def measure_hands() -> list[str]:
    """Measure what soft hands cost, and how they press.

    Returns:
        Lines of Markdown, none where there are no hands.
    """
    cost, press = companion("hand_cost"), companion("hand_press")
    if cost is None or press is None:
        return []
    return [*cost.cost_lines(), "", *press.press_lines(), ""]


def measure_live_surfaces() -> list[str]:
    """Measure what surfaces cost while clay is worked, and how far off they are.

    Returns:
        Lines of Markdown, none where there is no such module.
    """
    surface = companion("live_surface")
    if surface is None:
        return []
    return list(surface.surface_lines([surface.measure_surface(size) for size in surface.SIZES]))


def measure_frames() -> list[str]:
    """Measure where the time of a frame of live sculpting goes.

    Returns:
        Lines of Markdown, none where there is no Blender.
    """
    budget = companion("frame_budget")
    if budget is None or importlib.util.find_spec("bpy") is None:
        return []
    return list(budget.budget_lines())
