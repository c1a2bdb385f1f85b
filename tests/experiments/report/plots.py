# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of the report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure as Picture
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from tactile_clay.solver import Settings
from tactile_clay.solver.scene.settings import MODELS

from .point import Outcome
from .stability import MODULI, Behavior, Cell, Margin
from .stability import SUBSTEPS as MAP_SUBSTEPS
from .sweep import QUALITIES, Combined, front

INK = "#2b2724"
FAINT = "#d9d2ca"
PAPER = "#fffdfa"
ACCENT = "#b5482a"
GOOD = "#4c7f62"
FAIR = "#d9a441"
SUBSTEP_COLORS = {1: "#e3b08a", 2: "#d98452", 4: "#b5482a", 8: "#7c2f3c", 16: "#3f2444"}
SPACING_MARKERS = ("o", "v", "s", "D")
MODEL_LINES = ("none", INK, GOOD, FAIR)
MIN_DRAWN = 1e-3
"""Smaller errors, in goals, are drawn at this value."""
MAX_DRAWN = 1e2
"""Larger errors, in goals, and runs that failed are drawn at this value."""


def _picture(width: float, height: float) -> Picture:
    picture = Picture(figsize=(width, height), dpi=150, facecolor=PAPER, layout="constrained")
    engine = picture.get_layout_engine()
    assert isinstance(engine, ConstrainedLayoutEngine)
    engine.set(w_pad=0.08, h_pad=0.08)
    return picture


def _dress(axes: Axes, *, title: str = "", x: str = "", y: str = "") -> None:
    axes.set_facecolor(PAPER)
    axes.set_title(title, loc="left", color=INK, fontsize=10, fontweight="bold")
    axes.set_xlabel(x, color=INK, fontsize=9)
    axes.set_ylabel(y, color=INK, fontsize=9)
    axes.tick_params(colors=INK, labelsize=8, which="both", length=3)
    axes.grid(True, color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(INK)


def _plain_log(axis: Any, subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Label a logarithmic axis with plain numbers."""
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def _size(iterations: int | None) -> float:
    # If the solver chooses, the default material gets about six.
    iterations = iterations or 6
    return 8.0 + 11.0 * math.log2(iterations + 1) ** 1.6


def _save(picture: Picture, path: Path) -> None:
    picture.savefig(path, facecolor=PAPER)


def _label(settings: Settings) -> str:
    return f"{settings.substeps} × {settings.iterations or 'auto'}"


def _substeps_legend(axes: Axes, used: Sequence[int], **place: Any) -> None:
    handles = [
        Line2D([], [], marker="o", linestyle="", color=SUBSTEP_COLORS[n], label=str(n))
        for n in used
    ]
    legend = axes.legend(
        handles=handles,
        title="substeps",
        fontsize=8,
        title_fontsize=8,
        frameon=False,
        labelcolor=INK,
        **place,
    )
    axes.add_artist(legend)


def plot_combined(combined: Sequence[Combined], chosen: dict[str, Combined], path: Path) -> None:
    """Mean error over all goals against cost, with the front and the qualities."""
    picture = _picture(7.6, 5.0)
    axes = picture.add_subplot()
    _dress(
        axes,
        title="Error against cost, over all swept experiments",
        x="processor time per particle and frame [µs]",
        y="mean error, in goals",
    )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.axhline(1.0, color=GOOD, linewidth=1.0, linestyle="--")
    for item in combined:
        axes.scatter(
            item.microseconds,
            item.mean,
            s=_size(item.settings.iterations),
            color=SUBSTEP_COLORS.get(item.settings.substeps, INK),
            edgecolor=MODEL_LINES[MODELS.index(item.settings.model) % len(MODEL_LINES)],
            alpha=0.9,
            zorder=3,
        )
    edge = front((c.microseconds, c.mean, c) for c in combined)
    axes.plot(
        [x for x, _, _ in edge],
        [y for _, y, _ in edge],
        color=INK,
        linewidth=1.2,
        drawstyle="steps-post",
        zorder=2,
    )
    for place, name in enumerate(QUALITIES):
        if name not in chosen:
            continue
        item = chosen[name]
        axes.scatter(
            item.microseconds,
            item.mean,
            s=170,
            facecolor="none",
            edgecolor=INK,
            linewidth=1.6,
            zorder=4,
        )
        axes.annotate(
            f"{name}\n{_label(item.settings)}",
            (item.microseconds, item.mean),
            # Offset sideways, because the chosen may lie close together.
            xytext=(45 * (place - 1), -44 - 14 * (place % 2)),
            textcoords="offset points",
            fontsize=9,
            fontweight="bold",
            color=INK,
            ha="center",
            arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.8, "shrinkB": 7},
        )
    _plain_log(axes.xaxis)
    _plain_log(axes.yaxis)
    means = [c.mean for c in combined] + [1.0]
    axes.set_ylim(min(means) / 1.9, max(means) * 1.2)
    costs = [c.microseconds for c in combined]
    # Leave space for the legends and names.
    axes.set_xlim(min(costs) / 2.0, max(costs) * 4.5)
    used = sorted({c.settings.substeps for c in combined})
    _substeps_legend(axes, used, loc="upper right")
    handles = [
        axes.scatter([], [], s=_size(n), color=FAINT, label=str(n))
        for n in sorted({c.settings.iterations for c in combined if c.settings.iterations})
    ]
    _iterations_legend(axes, handles)
    _save(picture, path)


def _iterations_legend(axes: Axes, handles: Sequence[PathCollection]) -> None:
    axes.legend(
        handles=list(handles),
        title="iterations",
        fontsize=8,
        title_fontsize=8,
        frameon=False,
        labelcolor=INK,
        loc="upper right",
        bbox_to_anchor=(0.86, 1.0),
    )


def _drawn(score: float) -> float:
    return min(max(score, MIN_DRAWN), MAX_DRAWN)


def plot_experiments(outcomes: Sequence[Outcome], path: Path) -> None:
    """Worst error of each experiment against its cost, one panel per experiment."""
    names = list(dict.fromkeys(o.point.experiment for o in outcomes))
    columns = 3 if len(names) > 4 else 2
    rows = math.ceil(len(names) / columns)
    picture = _picture(3.6 * columns, 2.9 * rows + 0.7)
    panels = picture.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    for axes, name in zip(panels.flat, names, strict=False):
        group = [o for o in outcomes if o.point.experiment == name]
        spacings = list(dict.fromkeys(o.point.spacing for o in group))
        _dress(axes, title=name, x="core-ms per frame")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(MIN_DRAWN / 1.6, MAX_DRAWN * 1.6)
        axes.axhline(1.0, color=GOOD, linewidth=1.0, linestyle="--")
        for outcome in group:
            _experiment_point(axes, outcome, spacings)
        first = [o for o in group if o.point.spacing == spacings[0]]
        edge = front((o.core_ms, _drawn(o.score), o) for o in first)
        axes.plot(
            [x for x, _, _ in edge],
            [y for _, y, _ in edge],
            color=INK,
            linewidth=1.1,
            drawstyle="steps-post",
            zorder=2,
        )
        _plain_log(axes.xaxis)
        axes.yaxis.set_major_locator(LogLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(_score_text))
        axes.yaxis.set_minor_locator(NullLocator())
        if len(spacings) > 1:
            handles = [
                Line2D(
                    [], [], marker=m, linestyle="", color=INK, markersize=4.5,
                    label=f"{1e3 * d:g} mm",
                )
                for m, d in zip(SPACING_MARKERS, spacings, strict=False)
            ]  # fmt: skip
            axes.legend(handles=handles, fontsize=7, frameon=False, labelcolor=INK, loc="best")
    for axes in panels[:, 0]:
        axes.set_ylabel("worst error, in goals", color=INK, fontsize=9)
    used = sorted({o.point.settings.substeps for o in outcomes})
    picture.legend(
        handles=[
            *(
                Line2D([], [], marker="o", linestyle="", color=SUBSTEP_COLORS[n], label=str(n))
                for n in used
            ),
            Line2D(
                [], [], marker="o", linestyle="", markerfacecolor="none", markeredgecolor=INK,
                markersize=11, label="live",
            ),
            Line2D([], [], color=INK, linewidth=1.1, label="front"),
            Line2D([], [], color=GOOD, linestyle="--", label="goal"),
        ],
        loc="outside upper center",
        ncols=len(used) + 3,
        fontsize=8,
        frameon=False,
        title="color: substeps; size: iterations",
        title_fontsize=8,
        labelcolor=INK,
    )  # fmt: skip
    _save(picture, path)


def _experiment_point(axes: Axes, outcome: Outcome, spacings: Sequence[float]) -> None:
    settings = outcome.point.settings
    index = spacings.index(outcome.point.spacing)
    axes.scatter(
        outcome.core_ms,
        _drawn(outcome.score),
        s=0.7 * _size(settings.iterations),
        marker=SPACING_MARKERS[index % len(SPACING_MARKERS)],
        color=SUBSTEP_COLORS.get(settings.substeps, INK),
        edgecolor=MODEL_LINES[MODELS.index(settings.model) % len(MODEL_LINES)],
        alpha=0.9 if index == 0 else 0.55,
        zorder=3,
    )
    if settings == Settings() and index == 0:
        axes.scatter(
            outcome.core_ms,
            _drawn(outcome.score),
            s=130,
            facecolor="none",
            edgecolor=INK,
            linewidth=1.3,
            zorder=4,
        )


def _score_text(value: float, _: int = 0) -> str:
    if value <= MIN_DRAWN:
        return f"≤ {MIN_DRAWN:g}"
    return f"≥ {MAX_DRAWN:g}" if value >= MAX_DRAWN else f"{value:g}"


def plot_scoreboard(outcomes: Sequence[Outcome], path: Path) -> None:
    """Every figure of every experiment at the live setting: its error over its goal."""
    lines = [(o.point.experiment, m) for o in outcomes for m in o.measurements]
    picture = _picture(8.0, 0.24 * len(lines) + 1.0)
    axes = picture.add_subplot()
    _dress(axes, title="Errors at the live setting", x="error, in goals (1: just met)")
    axes.set_xscale("log")
    axes.set_xlim(MIN_DRAWN / 1.3, MAX_DRAWN)
    axes.grid(False, axis="y")
    axes.axvline(1.0, color=INK, linewidth=1.0)
    names = []
    for row, (experiment, m) in enumerate(lines):
        color = GOOD if m.score <= 1.0 else FAIR if m.score <= 2.0 else ACCENT
        end = _drawn(m.score)
        start = MIN_DRAWN / 1.3
        axes.plot((start, end), (row, row), color=color, linewidth=5, solid_capstyle="butt")
        axes.annotate(
            f"{m.value:.4g} {m.unit}".strip(),
            (end, row),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
            color=INK,
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0},
        )
        names.append(f"{experiment}: {m.figure}")
    axes.set_yticks(range(len(lines)), names, fontsize=7.5)
    axes.set_ylim(len(lines) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(LogLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(_score_text))
    axes.xaxis.set_minor_locator(NullLocator())
    _save(picture, path)


def plot_stability(
    cells: Sequence[Cell], settings: Settings, shear_modulus: float, margin: Margin, path: Path
) -> None:
    """Map of length of a substep and stiffness, where clay is stable, jitters or blows up."""
    order = (Behavior.STABLE, Behavior.JITTER, Behavior.BLOWN_UP)
    substeps = [n for n in MAP_SUBSTEPS if any(c.substeps == n for c in cells)]
    moduli = [g for g in MODULI if any(c.shear_modulus == g for c in cells)]
    table = np.full((len(moduli), len(substeps)), np.nan)
    for cell in cells:
        place = moduli.index(cell.shear_modulus), substeps.index(cell.substeps)
        table[place] = order.index(cell.behavior)
    picture = _picture(7.4, 4.6)
    axes = picture.add_subplot()
    _dress(
        axes,
        title=f"Stability with {settings.iterations or 'automatic'} iterations",
        x="substep [ms]  (substeps per frame)",
        y="shear modulus [Pa]",
    )
    axes.grid(False)
    axes.pcolormesh(
        np.arange(len(substeps) + 1) - 0.5,
        np.arange(len(moduli) + 1) - 0.5,
        table,
        cmap=ListedColormap(["#a8c3ae", "#efcf8d", "#d68a6c"]),
        norm=BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3),
        edgecolor=PAPER,
        linewidth=2,
    )
    for cell in cells:
        axes.annotate(
            _speed_text(cell),
            (substeps.index(cell.substeps), moduli.index(cell.shear_modulus)),
            ha="center",
            va="center",
            fontsize=6.5,
            color=INK,
        )
    _mark_live(axes, substeps, moduli, settings, shear_modulus)
    axes.set_xticks(range(len(substeps)), [f"{1e3 / 60.0 / n:.2g}\n({n})" for n in substeps])
    axes.set_yticks(range(len(moduli)), [_modulus_text(g) for g in moduli])
    handles = [
        Line2D([], [], marker="s", linestyle="", markersize=9, color=color, label=behavior.value)
        for color, behavior in zip(("#a8c3ae", "#efcf8d", "#d68a6c"), order, strict=True)
    ]
    handles.append(
        Line2D(
            [], [], marker="s", linestyle="", markersize=11, markerfacecolor="none",
            markeredgecolor=INK, markeredgewidth=2,
            label=f"live: {_margin_text(margin)}",
        )
    )  # fmt: skip
    picture.legend(
        handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False,
        labelcolor=INK,
    )  # fmt: skip
    _save(picture, path)


def _mark_live(
    axes: Axes,
    substeps: Sequence[int],
    moduli: Sequence[float],
    settings: Settings,
    shear_modulus: float,
) -> None:
    if settings.substeps not in substeps:
        return
    row = min(range(len(moduli)), key=lambda n: abs(math.log(moduli[n] / shear_modulus)))
    column = substeps.index(settings.substeps)
    axes.plot(
        [column - 0.46, column + 0.46, column + 0.46, column - 0.46, column - 0.46],
        [row - 0.44, row - 0.44, row + 0.44, row + 0.44, row - 0.44],
        color=INK,
        linewidth=2,
    )


def _margin_text(margin: Margin) -> str:
    longer = f"{'' if margin.time_step_bounded else '≥ '}{margin.time_step:.2g}"
    stiffer = f"{'' if margin.stiffness_bounded else '≥ '}{margin.stiffness:.2g}"
    return f"stable to {longer} × the substep, {stiffer} × the stiffness"


def _speed_text(cell: Cell) -> str:
    if cell.behavior is Behavior.BLOWN_UP:
        return f"{cell.max_speed:.1f} m/s" if math.isfinite(cell.max_speed) else "—"
    return f"{1e3 * cell.rms_speed:.0e}".replace("e-0", "e-") + " mm/s"


def _modulus_text(modulus: float) -> str:
    for scale, unit in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")):
        if modulus >= scale:
            return f"{float(f'{modulus / scale:.2g}'):g} {unit}"
    return f"{modulus:.0f} Pa"
