# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of touch: hands seen from the palm side, colored by pressure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure as Picture
from numpy.typing import NDArray

from tactile_clay.haptics import Foci, reconstruct

from .drive_statistics import DriveStatistics
from .touch import Hand, MaterialTouch, ModulationComparison, Touch, WeightsComparison

INK = "#2b2724"
PAPER = "#fffdfa"
SKIN = (0.93, 0.90, 0.87)
HEAT = LinearSegmentedColormap.from_list(
    "heat", ["#ede6de", "#f3cf9b", "#e08a4f", "#b5482a", "#5c1a2b"]
)
GREENS = LinearSegmentedColormap.from_list("greens", ["#ede6de", "#9cc3a5", "#2f6b4f"])

Array = NDArray[np.float64]


def draw_palm(
    axes: Axes,
    hand: Hand,
    values: Array,
    title: str,
    *,
    colors: LinearSegmentedColormap = HEAT,
    top: float,
) -> None:
    """Draw the palm side of a hand, with one value per vertex."""
    places = hand.rig.vertices
    faces = hand.rig.faces
    corners = places[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    seen = normal[:, 2] < 0.0
    order = np.argsort(-corners[seen][:, :, 2].mean(1))
    flat = corners[seen][order][:, :, :2] * (-1e3, 1e3)
    value = values[faces[seen][order]].mean(1)
    color = colors(Normalize(0.0, top)(value))
    # Slight shading shows the shape.
    color[:, :3] *= (0.72 + 0.28 * -normal[seen][order, 2])[:, None]
    axes.add_collection(
        PolyCollection(list(flat), facecolors=color, edgecolors=color, linewidths=0.3)
    )
    axes.set_xlim(-60, 95)
    axes.set_ylim(-30, 200)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title(title, fontsize=9, color=INK)


def draw_foci(axes: Axes, foci: Foci, top: float) -> None:
    """Draw foci as rings, larger for higher pressure."""
    axes.scatter(
        -1e3 * foci.positions[:, 0],
        1e3 * foci.positions[:, 1],
        s=14 + 50 * foci.pressures / top,
        facecolors="none",
        edgecolors=INK,
        linewidths=1.0,
    )


def draw_scale(
    picture: Picture,
    axes: Sequence[Axes],
    top: float,
    text: str,
    *,
    colors: LinearSegmentedColormap = HEAT,
) -> None:
    """Draw a color scale beside panels."""
    bar = picture.colorbar(
        ScalarMappable(Normalize(0.0, top), colors), ax=list(axes), shrink=0.6, pad=0.01, aspect=24
    )
    bar.set_label(text, color=INK, fontsize=8)
    bar.ax.tick_params(colors=INK, labelsize=7)
    bar.outline.set_visible(False)


def draw_weights(result: WeightsComparison, path: Path) -> None:
    """Draw target, weights, and rendered pressure with and without them, after figure 4."""
    picture = Picture(figsize=(11.5, 4.6), dpi=150, facecolor=PAPER, layout="constrained")
    panels = list(picture.subplots(1, 4))
    hand, weighted, even = result.hand, result.weighted, result.even
    top = float(max(weighted.foci.pressures.max(), weighted.field.pressures.max()))

    def pressure(axes: Axes, touch: Touch, values: Array, title: str) -> None:
        shown = hand.on_vertices(touch.field.ghosts, values)
        draw_palm(axes, hand, shown, title, top=top)

    pressure(panels[0], weighted, weighted.field.pressures, "target pressure p*")
    draw_palm(panels[1], hand, hand.skin.vertices, "perceptual weight α", colors=GREENS, top=1.0)
    for axes, touch, title in ((panels[2], even, "without"), (panels[3], weighted, "with")):
        served = result.on_pads(touch)
        pressure(
            axes, touch, touch.rendered,
            f"rendered {title} weights\nerror on pads {served.error:.0%}",
        )  # fmt: skip
        draw_foci(axes, touch.foci, top)
    draw_scale(picture, panels[1:2], 1.0, "α", colors=GREENS)
    draw_scale(picture, panels[3:], top, "Pa")
    picture.savefig(path)


def draw_modulations(results: Sequence[ModulationComparison], hand: Hand, path: Path) -> None:
    """Draw target, amplitude and spatiotemporal modulation, one row per contact."""
    rows = [r for r in results if r.contact in ("palm", "whole hand")]
    picture = Picture(
        figsize=(8.6, 4.5 * len(rows)), dpi=150, facecolor=PAPER, layout="constrained"
    )
    grid = picture.subplots(len(rows), 3, squeeze=False)
    for panels, r in zip(grid, rows, strict=True):
        field = r.field
        top = float(field.pressures.max())
        still = r.amplitude.gain * reconstruct(r.foci, field.positions)
        moving = r.spatiotemporal.gain * r.route.time_average(field.positions)
        for axes, values, title in (
            (panels[0], field.pressures, f"{r.contact}, {1e4 * r.touched_area:.0f} cm²"),
            (
                panels[1],
                still,
                f"{r.foci.count} foci at once\nshape error {r.amplitude.shape_error:.0%}",
            ),
            (
                panels[2],
                moving,
                f"{r.route.focus_count} foci on a route, time average\n"
                f"shape error {r.spatiotemporal.shape_error:.0%}",
            ),
        ):
            shown = hand.on_vertices(field.ghosts, values)
            draw_palm(axes, hand, shown, title, top=top)
        draw_foci(panels[1], r.foci, top)
        loop = np.vstack((r.route.positions, r.route.positions[:1]))
        panels[2].plot(-1e3 * loop[:, 0], 1e3 * loop[:, 1], color=INK, linewidth=0.7, alpha=0.7)
        draw_scale(picture, list(panels[2:]), top, "Pa, at the best gain")
    picture.savefig(path)


def draw_materials(results: Sequence[MaterialTouch], path: Path) -> None:
    """Draw contact and focal pressure against the clay's yield stress, after figure 6."""
    picture = Picture(figsize=(6.4, 3.4), dpi=150, facecolor=PAPER, layout="constrained")
    axes = picture.subplots()
    axes.set_facecolor(PAPER)
    rows = sorted(results, key=lambda r: r.yield_stress)
    stress = [1e-3 * r.yield_stress for r in rows]
    axes.loglog(
        stress,
        [1e-3 * r.contact_pressure for r in rows],
        "o-",
        color="#4c7f62",
        label="clay on the fingertip, kPa",
    )
    axes.loglog(
        stress,
        [1e-3 * r.focal_pressure for r in rows],
        "s-",
        color="#b5482a",
        label="focal point, kPa",
    )
    for r, x in zip(rows, stress, strict=True):
        axes.annotate(
            r.name.replace("_", " "), (x, 1e-3 * r.contact_pressure), textcoords="offset points",
            xytext=(0, 7), ha="center", fontsize=7, color=INK,
        )  # fmt: skip
    axes.set_xlabel("yield stress [kPa]", color=INK, fontsize=8)
    axes.set_ylim(0.15, 600)
    axes.tick_params(colors=INK, labelsize=7)
    axes.grid(True, color="#d9d2ca", linewidth=0.5)
    axes.legend(fontsize=7, frameon=False, labelcolor=INK, loc="center right")
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
    picture.savefig(path)


def draw_drives(results: Sequence[DriveStatistics], path: Path) -> None:
    """Draw the spread of achieved over wanted pressure, one row per method or driver board."""
    picture = Picture(
        figsize=(7.2, 0.34 * len(results) + 1.0), dpi=150, facecolor=PAPER, layout="constrained"
    )
    axes = picture.subplots()
    axes.set_facecolor(PAPER)
    for row, result in enumerate(results):
        low, first, middle, last, high = np.percentile(result.ratios, (1, 25, 50, 75, 99))
        y = len(results) - 1 - row
        axes.plot((low, high), (y, y), color="#b9aea2", linewidth=2.2, solid_capstyle="round")
        axes.plot((first, last), (y, y), color="#b5482a", linewidth=6, solid_capstyle="butt")
        axes.plot(middle, y, "|", color=INK, markersize=11)
    axes.set_yticks(range(len(results)))
    axes.set_yticklabels([f"{r.method}: {r.array}" for r in reversed(results)], fontsize=7)
    axes.set_xlabel(
        "achieved over wanted pressure: median, quartiles, 1 to 99 %", color=INK, fontsize=8
    )
    axes.axvline(1.0, color=INK, linewidth=0.6)
    axes.tick_params(colors=INK, labelsize=7)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
    picture.savefig(path)
