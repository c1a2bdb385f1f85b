# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's section on touch: accuracy of the rendering, in tables and pictures.

``python -m tactile_clay.tests.experiments.touch_report FOLDER`` writes only this, as touch.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tactile_clay.haptics import TransducerArray, acoustic_field, solve_drive

from . import touch_pictures
from .drive_statistics import DriveStatistics, judge_methods, judge_presets, judge_steps
from .report.companions import companion
from .touch import (
    Hand,
    Misfit,
    compare_modulations,
    compare_rules,
    compare_weights,
    generated_hand,
    press_materials,
)

MATERIALS = ("wet_clay", "soft_play_dough", "plasticine", "throwing_clay", "stiff_clay")


def run_touch(folder: Path, *, sets: int = 1000) -> list[str]:
    """Run all experiments on touch, and draw the pictures.

    Args:
        folder: Folder for the pictures.
        sets: Number of random sets of foci on which drives are judged.

    Returns:
        Lines of Markdown.
    """
    hand = generated_hand()
    lines = [
        "A hand sunk into clay, pressed evenly from below with 15 kPa, 20 cm above an array. "
        "Errors are root mean squares over the skin that faces the array, relative to that of the "
        "wanted pressure; the *shape error* is that at the best common gain; *coverage* is the "
        "fraction of the touched skin that then gets at least half its pressure.",
        "",
    ]
    lines += _weights(hand, folder)
    lines += _materials(folder)
    pressed = companion("touch_hand")
    if pressed:
        lines += pressed.press_lines(folder)
    lines += _rules(hand)
    lines += _modulations(hand, folder)
    lines += _focus_widths()
    return lines + _drives(folder, sets)


def _weights(hand: Hand, folder: Path) -> list[str]:
    result = compare_weights(hand)
    touch_pictures.draw_weights(result, folder / "touch_weights.png")
    rows = [
        (where, part(result.even), part(result.weighted))
        for where, part in (("finger pads", result.on_pads), ("elsewhere", result.elsewhere))
    ]
    return [
        "### Perceptual weights (the paper's figure 4)",
        "",
        "![With and without weights](touch_weights.png)",
        "",
        "| skin | error without weights | with weights | coverage without | with |",
        "|---|---|---|---|---|",
        *(
            f"| {where} | {even.error:.1%} | {weighted.error:.1%} | {even.coverage:.0%} "
            f"| {weighted.coverage:.0%} |"
            for where, even, weighted in rows
        ),
        "",
    ]


def _materials(folder: Path) -> list[str]:
    results = press_materials(MATERIALS)
    touch_pictures.draw_materials(results, folder / "touch_materials.png")
    return [
        "### Softer clay presses less (figure 6)",
        "",
        "A ball of 12 mm is pressed 12 mm into a block at 0.1 m/s; the force is the solver's, "
        "spread evenly over the ball's contact.",
        "",
        "![Pressures against yield stress](touch_materials.png)",
        "",
        "| clay | yield stress | force | pressure of the clay | strongest focus |",
        "|---|---|---|---|---|",
        *(
            f"| {r.name.replace('_', ' ')} | {1e-3 * r.yield_stress:g} kPa | {r.force:.1f} N "
            f"| {1e-3 * r.contact_pressure:.1f} kPa | {r.focal_pressure:.0f} Pa |"
            for r in results
        ),
        "",
    ]


def _rules(hand: Hand) -> list[str]:
    return [
        "### Equation 9 as printed, and its minimizer",
        "",
        "| contact | foci | error, minimizer | error, as printed | printed too small by |",
        "|---|---|---|---|---|",
        *(
            f"| {r.contact} | {r.focus_count} | {r.true.error:.1%} | {r.printed.error:.1%} "
            f"| {r.gain:.2f} |"
            for r in compare_rules(hand)
        ),
        "",
    ]


def _modulations(hand: Hand, folder: Path) -> list[str]:
    results = compare_modulations(hand)
    touch_pictures.draw_modulations(results, hand, folder / "touch_modulations.png")

    def cells(misfit: Misfit) -> str:
        return f"{misfit.shape_error:.1%} | {misfit.coverage:.0%} | {1 / misfit.gain:.2f}"

    lines = [
        "### Amplitude and spatiotemporal modulation",
        "",
        "![Amplitude and spatiotemporal modulation](touch_modulations.png)",
        "",
        "*Strength* is rendered over wanted pressure: a moving focus is at each point only part of "
        "the time. *Gaussian* models foci as the paper does; *sound* is the simulated pressure "
        "of the whole array, including the field between foci.",
        "",
        "| contact | modulation | foci | a point is passed | Gaussian: shape error | coverage "
        "| strength | sound: shape error | coverage | strength |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in results:
        area = f"{r.contact}, {1e4 * r.touched_area:.0f} cm²"
        lines.append(
            f"| {area} | amplitude | {r.foci.count} | always | {cells(r.amplitude)} "
            f"| {cells(r.amplitude_sound)} |"
        )
        lines.append(
            f"| | spatiotemporal | {r.route.focus_count} | {r.route.repeat_rate:.0f} /s "
            f"| {cells(r.spatiotemporal)} | {cells(r.spatiotemporal_sound)} |"
        )
    return [*lines, ""]


def _focus_widths() -> list[str]:
    """Table of the actual width of a focus, compared with the paper's wavelength."""
    heights = (0.10, 0.15, 0.20, 0.30)
    lines = [
        "### Width of a focus",
        "",
        "Standard deviation of the Gaussian that falls to e^-½ at the same distance as the "
        "simulated focus, over the wavelength, which equation 9 uses; by height above the array.",
        "",
        f"| array | {' | '.join(f'{100 * height:.0f} cm' for height in heights)} |",
        "|---" * (len(heights) + 1) + "|",
    ]
    for name in TransducerArray.preset_names():
        array = TransducerArray.preset(name)
        widths = [focus_width(array, height) / array.wavelength for height in heights]
        lines.append(f"| {name} | {' | '.join(f'{width:.2f}' for width in widths)} |")
    return [*lines, ""]


def focus_width(array: TransducerArray, height: float) -> float:
    """Distance from a focus on the axis at which its pressure falls to e^-½ [m]."""
    middle = (0.0, 0.0, height)
    drive = solve_drive(array, [middle], [1e9])
    away = np.linspace(0.0, 0.04, 801)
    points = np.stack([away, 0.0 * away, 0.0 * away + height], axis=1)
    pressure = np.abs(acoustic_field(array, drive, points))
    return float(away[np.argmax(pressure < np.exp(-0.5) * pressure[0])])


def _drives(folder: Path, sets: int) -> list[str]:
    methods, steps, presets = judge_methods(sets), judge_steps(sets), judge_presets(sets)
    touch_pictures.draw_drives([*methods, *steps], folder / "touch_drives.png")
    return [
        "### Drives",
        "",
        f"{sets:,} random sets of 1 to 32 foci with unequal pressures, in 12 × 12 × 10 cm above "
        "16 × 16 transducers. *Spread* is the standard deviation of achieved over wanted pressure, "
        "relative to the mean of each set; *uniformity* is 1 − (max − min)/(max + min) of a set; "
        "*weakest* is the ratio that 99 of 100 foci exceed. Times are on one core.",
        "",
        "![Achieved over wanted pressure](touch_drives.png)",
        "",
        *_drive_table("method", [(r.method, r) for r in methods]),
        "Loss from the quantization of driver boards, with the default method:",
        "",
        *_drive_table("driver", [(r.array, r) for r in steps]),
        "Presets, K = 1 to 8 foci of .3 to 1 times .3/√K of the pressure of one focus at 20 cm:",
        "",
        *_drive_table("array", [(r.array, r) for r in presets]),
    ]


def _drive_table(title: str, rows: Sequence[tuple[str, DriveStatistics]]) -> list[str]:
    return [
        f"| {title} | mean | spread | uniformity | weakest | ms |",
        "|---|---|---|---|---|---|",
        *(
            f"| {name} | {r.mean:.3f} | {r.deviation:.4f} | {r.uniformity:.3f} | {r.weakest:.2f} "
            f"| {r.milliseconds:.2f} |"
            for name, r in rows
        ),
        "",
    ]


if __name__ == "__main__":
    output = Path(sys.argv[1] if len(sys.argv) > 1 else "build/report")
    output.mkdir(parents=True, exist_ok=True)
    text = "\n".join(["# Measurements of touch", "", *run_touch(output)])
    (output / "touch.md").write_text(text + "\n", encoding="utf-8")
