# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the experiments and writes what they measured beside what theory says.

Leaves build/report/report.md and build/report/report.json.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import warp as wp

from tactile_clay.solver import Material, Settings

from .falling import drop, free_fall
from .merge import merge
from .motion import collision, spin
from .press import press
from .slump import slump
from .standing import GRAVITY, stand

SUBSTEPS = (2, 4, 8)
ITERATIONS = (2, 4, 8)


@dataclass(frozen=True)
class Row:
    """One measured figure."""

    experiment: str
    figure: str
    measured: float
    expected: str


def measure_all() -> list[Row]:
    """Run every experiment at the live setting."""
    rows: list[Row] = []

    def add(experiment: str, figure: str, measured: float, expected: str | float) -> None:
        text = expected if isinstance(expected, str) else f"{expected:.4g}"
        rows.append(Row(experiment, figure, float(measured), text))

    fall = free_fall()
    add("free fall, 0.5 s", "depth [m]", fall.fallen, fall.expected)
    landing = drop()
    add("drop of 50 mm", "impulse over m g t", landing.impulse_ratio, 1.0)
    turning = spin()
    add("spin, 10 rad/s, 1 s", "angular momentum kept", turning.spin_kept, 1.0)
    meeting = collision()
    add("collision", "linear momentum change", meeting.momentum_change, 0.0)
    add("collision", "angular momentum change", meeting.spin_change, 0.0)
    rest = stand()
    add("rest", "weight over m g", rest.normal_force, 1.0)
    add("rest", "drift in 1 s [m]", rest.drift, 0.0)
    holding = stand(math.radians(15), friction=0.6)
    add("incline 15°, μ 0.6", "slip in 1 s [m]", holding.slip, 0.0)
    add("incline 15°, μ 0.6", "tangential force over m g", holding.tangential_force, "0.2588")
    sliding = stand(math.radians(35), friction=0.6)
    expected = GRAVITY * (math.sin(math.radians(35)) - 0.6 * math.cos(math.radians(35)))
    add("incline 35°, μ 0.6", "acceleration [m/s²]", sliding.acceleration, expected)
    for ratio in (0.1, 0.2, 0.3):
        slumped = slump(ratio)
        theory = f"{slumped.pashias:.3f} Pashias, {slumped.von_mises:.3f} von Mises"
        add(f"slump, τ′ {ratio}", "slump over height", slumped.measured, theory)
    for stress in (2e3, 5e3, 10e3):
        pressed = press(material=Material(yield_stress=stress))
        name = f"press of a ball, 12 mm, {stress / 1e3:.0f} kPa"
        theory = f"{pressed.theory[0]:.1f} to {pressed.theory[1]:.1f}"
        add(name, "force moving [N]", pressed.force_moving, theory)
        add(name, "force held [N]", pressed.force_held, theory)
        add(name, "spring-back", pressed.spring_back, "0 for a plastic")
        add(name, "compression left", pressed.compression_left, 0.0)
    merged = merge()
    add("merge, lift by 20 mm", "lower block rises [m]", merged.lower, merged.lift)
    apart = merge(material=Material(cohesion=0.0))
    add("merge without cohesion", "lower block rises [m]", apart.lower, 0.0)
    return rows


def measure_settings(say: Callable[[str], None]) -> list[dict[str, float]]:
    """Press at several settings: error against cost."""
    results = []
    for substeps in SUBSTEPS:
        for iterations in ITERATIONS:
            begin = time.perf_counter()
            pressed = press(settings=Settings(substeps=substeps, iterations=iterations))
            middle = sum(pressed.theory) / 2
            results.append(
                {
                    "substeps": substeps,
                    "iterations": iterations,
                    "seconds": time.perf_counter() - begin,
                    "force_moving_error": pressed.force_moving / middle - 1,
                    "force_held_error": pressed.force_held / middle - 1,
                    "spring_back": pressed.spring_back,
                }
            )
            say(f"  {substeps} substeps, {iterations} iterations")
    return results


def write(folder: Path, rows: list[Row], settings: list[dict[str, float]]) -> None:
    """Write the report."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["# What the clay was measured to do", "", "At the live setting (`Settings()`):", ""]
    lines += ["| experiment | figure | measured | expected |", "|---|---|---|---|"]
    lines += [f"| {r.experiment} | {r.figure} | {r.measured:.4g} | {r.expected} |" for r in rows]
    lines += ["", "Press of a ball at other settings; the time is of the whole experiment:", ""]
    lines += ["| substeps | iterations | s | moving force | held force | spring-back |"]
    lines += ["|---|---|---|---|---|---|"]
    lines += [
        f"| {s['substeps']} | {s['iterations']} | {s['seconds']:.1f} "
        f"| {s['force_moving_error']:+.0%} | {s['force_held_error']:+.0%} "
        f"| {s['spring_back']:.0%} |"
        for s in settings
    ]
    (folder / "report.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    data = {"figures": [asdict(row) for row in rows], "settings": settings}
    (folder / "report.json").write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def main() -> None:
    """Run everything and write the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/report"))
    options = parser.parse_args()
    wp.config.quiet = True
    print("Running the experiments ...", flush=True)
    rows = measure_all()
    print("Running the press at other settings ...", flush=True)
    settings = measure_settings(lambda text: print(text, flush=True))
    write(options.output, rows, settings)
    print(f"Wrote {options.output / 'report.md'} and report.json.")


if __name__ == "__main__":
    main()
