# SPDX-License-Identifier: GPL-3.0-or-later
"""The ablation as a picture, after the paper's figure 2.

``python -m tactile_clay.tests.experiments.ablation_picture ablation.png`` draws it.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .ablation import ANGLE, SPACING, VARIANTS, Ablation, drop_on_incline
from .ball_picture import View, shade, to_srgb

TIMES = (10 / 60, 18 / 60, 1.2)
"""Times during the impact, shortly after, and one second later [s]."""
ROW_NAMES = ("impact", "a moment later", "one second later")
COLORS = ((0.13, 0.50, 0.16), (0.66, 0.09, 0.07), (0.09, 0.22, 0.68), (0.62, 0.07, 0.42))
"""Colors of the variants, as in the paper's figure: green, red, blue, magenta."""
PANEL = (440, 330)
"""Width and height of one panel [pixels]."""
SUPERSAMPLING = 2
"""Supersampling factor along each axis."""
INCLINE = (-0.085, 0.145, 0.085)
"""Start, end and half width of the drawn incline [m]."""


def describe(result: Ablation) -> str:
    """Describe the outcome in one line."""
    if result.slide > 0.01:
        return f"slides: {result.slide * 1e2:.0f} cm in the last 0.4 s"
    if result.largest_piece < 0.9:
        return f"fractures: {result.pieces} pieces"
    if result.creep > 2e-4:
        return f"drifts: {result.creep * 1e3:.1f} mm in the last 0.4 s"
    if result.creep < 1e-6:
        return "holds: moves less than 0.001 mm in the last 0.4 s"
    return f"holds: moves {result.creep * 1e3:.3f} mm in the last 0.4 s"


def draw_ablation(results: Sequence[Ablation], path: Path) -> None:
    """Draw the variants side by side, time from top to bottom.

    Args:
        results: Results of `drop_on_incline` with `TIMES`, one per variant.
        path: Path of the PNG file.
    """
    head, margin, gutter = 62, 26, 8
    step_right, step_down = PANEL[0] + gutter, PANEL[1] + gutter
    size = (margin + step_right * len(results), head + step_down * len(TIMES))
    sheet = Image.new("RGB", size, "white")
    pen = ImageDraw.Draw(sheet)
    large, small = ImageFont.load_default(20), ImageFont.load_default(15)
    # From the incline's coordinates to the world's.
    turn = np.array(
        [[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, 1, 0], [-np.sin(ANGLE), 0, np.cos(ANGLE)]]
    )
    finer = (PANEL[0] * SUPERSAMPLING, PANEL[1] * SUPERSAMPLING)
    view = View(np.array((0.42, -0.78, 0.52)), np.array((0.026, 0.0, -0.012)), 0.262, finer)
    for column, (result, color) in enumerate(zip(results, COLORS, strict=False)):
        left = margin + step_right * column
        middle = left + PANEL[0] // 2
        shown = tuple(round(255 * c ** (1 / 2.2)) for c in color)
        pen.text((middle, 8), result.variant, "black", large, anchor="ma")
        pen.text((middle, 34), describe(result), shown, small, anchor="ma")
        for row, points in enumerate(result.frames):
            level = points.astype(float) @ turn.T
            there = (np.abs(level[:, 1]) < INCLINE[2]) & (level[:, 0] < INCLINE[1])
            drawn = to_srgb(shade(view, level[there], 0.58 * SPACING, color, ANGLE, INCLINE))
            panel = Image.fromarray(drawn).resize(PANEL, Image.Resampling.BOX)
            if not there.any():
                ImageDraw.Draw(panel).text(
                    (0.55 * PANEL[0], 0.42 * PANEL[1]),
                    f"gone: {points[:, 0].mean():.1f} m downhill",
                    shown,
                    large,
                    anchor="mm",
                )
            sheet.paste(panel, (left, head + step_down * row))
    for row, name in enumerate(ROW_NAMES):
        label = Image.new("RGB", (PANEL[1], margin), "white")
        ImageDraw.Draw(label).text(
            (PANEL[1] // 2, margin // 2), f"{name}, {TIMES[row]:.2f} s", "#555555", small, "mm"
        )
        sheet.paste(label.rotate(90, expand=True), (0, head + step_down * row))
    sheet.save(path)


def run_ablation(*, model: str = "paper") -> list[Ablation]:
    """Run all variants, with the positions that the picture shows."""
    return [drop_on_incline(variant, model=model, times=TIMES) for variant in VARIANTS]


if __name__ == "__main__":
    draw_ablation(run_ablation(), Path(sys.argv[1] if len(sys.argv) > 1 else "ablation.png"))
