# SPDX-License-Identifier: GPL-3.0-or-later
"""Times whole frames of clay being pressed by a moving ball, and writes build/bench/bench.json.

Wall-clock times are medians over frames in one process; compare them by their ratio.
"""

import argparse
import json
import os
import platform
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import warp as wp

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005
SIZES = {"2k": (13, 13, 13), "4k": (16, 16, 16), "20k": (27, 27, 27)}


def measure(
    counts: tuple[int, int, int], settings: Settings, *, frames: int, device: str
) -> dict[str, object]:
    """Press a ball of 12 mm radius into a block at 0.1 m/s and time each frame.

    Returns:
        Particles, settings, milliseconds a frame (median and 90th percentile), core milliseconds
        a frame, microseconds a particle and frame, and how far the block's weight on the table
        was from m g before the press.
    """
    scene = Scene(SPACING)
    scene.add_clay(block(counts, SPACING), Material())
    table = scene.add_plane()
    sphere = ball(0.012)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    height = counts[2] * SPACING + 0.0125
    tool.set_pose(at(0, 0, height))
    solver = Solver(scene, settings, device=device)
    for _ in range(8):
        solver.step(1 / 60)
    particles = scene.particle_count
    weight = particles * Material().density * SPACING**3 * 9.81
    weight_error = abs(float(-solver.force_on(table)[2]) / weight - 1.0)
    wall = []
    cores = time.process_time()
    for _ in range(frames):
        height -= 0.1 / 60
        tool.set_pose(at(0, 0, height))
        begin = time.perf_counter()
        solver.step(1 / 60)
        wall.append(time.perf_counter() - begin)
    cores = time.process_time() - cores
    return {
        "scene": "block pressed by a ball",
        "particles": particles,
        "device": str(solver.device),
        "settings": asdict(settings),
        "frames": frames,
        "ms_median": 1e3 * float(np.median(wall)),
        "ms_p90": 1e3 * float(np.percentile(wall, 90)),
        "core_ms": 1e3 * cores / frames,
        "microseconds_per_particle": 1e6 * float(np.median(wall)) / particles,
        "weight_error": weight_error,
    }


def main() -> None:
    """Run the cases and write what they gave."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/bench"))
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    wp.config.quiet = True
    cases = []
    for name, counts in SIZES.items():
        figures = measure(counts, Settings(), frames=options.frames, device=options.device)
        case = {"case": name, **figures}
        cases.append(case)
        print(
            f"{name:>4}  {case['particles']:>6} particles  {case['ms_median']:7.1f} ms a frame "
            f"(p90 {case['ms_p90']:.1f})  {case['microseconds_per_particle']:.1f} us a particle"
        )
    options.output.mkdir(parents=True, exist_ok=True)
    result = {
        "machine": {"processor": platform.machine(), "cores": os.cpu_count()},
        "versions": {"python": platform.python_version(), "warp": wp.__version__},
        "cases": cases,
    }
    path = options.output / "bench.json"
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(f"Wrote {path}.")


if __name__ == "__main__":
    main()
