# SPDX-License-Identifier: GPL-3.0-or-later
"""Times whole frames of clay in contact with a moving tool, and of touch, and writes bench.json.

Times are medians over frames in one process, after warming up; compare only their ratios if other
work shares the machine. Processor time counts all threads.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from tactile_clay.solver import Settings

from . import surface, touch, touch_latency, touch_silence
from .cases import FRAME, Case, chosen


def measure(case: Case, settings: Settings, device: str) -> dict[str, Any]:
    """Run a case.

    Returns:
        Its entry in bench.json.
    """
    run = case.make(settings, device)
    particles = run.solver.scene.particle_count
    wall, cores, awake, substeps = [], [], [], []
    for frame in range(run.frames):
        run.drive(frame)
        begin, busy = time.perf_counter(), time.process_time()
        run.solver.step(FRAME)
        wp.synchronize_device(run.solver.device)
        wall.append(1e3 * (time.perf_counter() - begin))
        cores.append(1e3 * (time.process_time() - busy))
        run.after(frame)
        figures = run.solver.diagnostics()
        awake.append(figures.awake)
        substeps.append(figures.substeps)
    error = run.judge()
    return {
        "case": case.name,
        "scene": case.scene,
        "particles": particles,
        "device": str(run.solver.device),
        "settings": asdict(settings),
        "frames": run.frames,
        "ms_median": float(np.median(wall)),
        "ms_p90": float(np.percentile(wall, 90)),
        "core_ms": float(np.median(cores)),
        "core_microseconds_per_particle": 1e3 * float(np.median(cores)) / particles,
        "goal_ms": None if math.isnan(case.goal) else case.goal,
        "awake": float(np.median(awake)),
        "substeps": float(np.median(substeps)),
        "error": {**asdict(error), "error": error.error},
    }


def sentence(figures: dict[str, Any]) -> str:
    """One line about a case."""
    goal = "" if figures["goal_ms"] is None else f", goal {figures['goal_ms']:g}"
    return (
        f"{figures['case']:>12}  {figures['particles']:>9,} particles  "
        f"{figures['ms_median']:8.1f} ms per frame (p90 {figures['ms_p90']:.1f}{goal})  "
        f"{figures['core_ms']:8.1f} core-ms  {figures['core_microseconds_per_particle']:6.2f} "
        f"µs per particle  {figures['error']['figure']}: {figures['error']['measured']:.4g}, "
        f"{figures['error']['error']:.1%} off"
    )


def main() -> None:
    """Run the cases and write their results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help="names of cases; by default all but the largest")
    parser.add_argument("--all", action="store_true", help="include the largest")
    parser.add_argument("--output", type=Path, default=Path("build/bench"))
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    wp.config.quiet = True
    touches = [case for case in touch.CASES if not options.cases or case.name in options.cases]
    others = [name for name in options.cases if name not in {case.name for case in touches}]
    try:
        cases = chosen(others, everything=options.all) if others or not options.cases else []
    except ValueError as error:
        parser.error(str(error))
    results = []
    for case in cases:
        reason = case.missing()
        if reason:
            print(f"{case.name:>12}  skipped: {reason}", flush=True)
            continue
        results.append(measure(case, Settings(), options.device))
        print(sentence(results[-1]), flush=True)
    touched = []
    for part in touches:
        touched.append(touch.measure(part))
        print(touch.sentence(touched[-1]), flush=True)
    surfaces = [] if options.cases else surface.measure_all()
    for result in surfaces:
        print(surface.sentence(result), flush=True)
    latencies = [] if options.cases else touch_latency.measure_all()
    for figures in latencies:
        print(touch_latency.sentence(figures), flush=True)
    # An array is emulated on a pty.
    silences = [] if options.cases or sys.platform == "win32" else touch_silence.measure_silence()
    for figures in silences:
        print(touch_silence.sentence(figures), flush=True)
    options.output.mkdir(parents=True, exist_ok=True)
    data = {
        "machine": {"processor": platform.machine(), "cores": os.cpu_count()},
        "versions": {"python": platform.python_version(), "warp": wp.__version__},
        "cases": results,
        "surface": [surface.figures(result) for result in surfaces],
        "touch": touched,
        "touch_latency": latencies,
        "touch_silence": silences,
    }
    path = options.output / "bench.json"
    path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    print(f"Wrote {path}.")


if __name__ == "__main__":
    main()
