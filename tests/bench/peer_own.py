# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the comparison scene in Tactile Clay.

python -m tactile_clay.tests.bench.peer_own scene.npz result.npz
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
import warp as wp

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.tests.experiments.shapes import at, ball


def run(scene: dict[str, np.ndarray], settings: Settings) -> dict[str, Any]:
    """Run the scene."""
    material = Material(
        density=float(scene["density"]),
        yield_stress=float(scene["yield_stress"]),
        viscosity=0.0,
        shear_modulus=float(scene["shear_modulus"]),
        friction=float(scene["friction"]),
    )
    own = Scene(float(scene["spacing"]))
    own.add_clay(scene["points"], material)
    own.add_plane(friction=float(scene["friction"]))
    sphere = ball(float(scene["radius"]))
    tool = own.add_mesh(sphere.vertices, sphere.faces, friction=float(scene["friction"]))
    tool.set_pose(at(0.0, 0.0, float(scene["heights"][0])))
    solver = Solver(own, settings)
    solver.begin()
    positions, forces, cores, walls = [], [], [], []
    for number, height in enumerate(scene["heights"]):
        tool.set_pose(at(0.0, 0.0, float(height)))
        wall, core = time.perf_counter(), time.process_time()
        solver.step(float(scene["frame"]))
        cores.append(time.process_time() - core)
        walls.append(time.perf_counter() - wall)
        forces.append(float(solver.force_on(tool)[2]))
        if number in scene["snapshots"]:
            positions.append(solver.positions())
    return {
        "positions": np.array(positions),
        "forces": np.array(forces),
        "core_seconds": np.array(cores),
        "wall_seconds": np.array(walls),
    }


if __name__ == "__main__":
    wp.config.quiet = True
    np.savez(sys.argv[2], **run(dict(np.load(sys.argv[1])), Settings()))
