# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the comparison scene in Newton's implicit material point method, in its own environment.

Set up like the mud in Newton's multi-material example (mpm_multi_material): the solver's
default bases, at most 250 iterations to a tolerance of 1e-6, particles projected out of colliders
after the step, one step a frame of 1/60 s, no internal friction, a yield pressure out of reach,
full tension. Voxels are of two particle spacings and the ball is a kinematic body, as in its
example of a body carried between two pads (mpm_pinch_carry).

    python peer_newton.py scene.npz result.npz
"""

from __future__ import annotations

import sys
import time
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverImplicitMPM

STEPS = 1
"""Solver steps per frame."""


def run(scene: dict[str, np.ndarray]) -> dict[str, Any]:
    """Run the scene."""
    spacing, radius, frame = (float(scene[name]) for name in ("spacing", "radius", "frame"))
    shear, bulk = float(scene["shear_modulus"]), float(scene["bulk_modulus"])
    friction = float(scene["friction"])
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -9.81))
    SolverImplicitMPM.register_custom_attributes(builder)
    touch = newton.ModelBuilder.ShapeConfig(density=0.0, mu=friction)
    builder.add_ground_plane(cfg=touch)
    count = len(scene["points"])
    builder.add_particles(
        pos=scene["points"].tolist(),
        vel=np.zeros((count, 3)).tolist(),
        mass=[float(scene["density"]) * spacing**3] * count,
        radius=[0.5 * spacing] * count,
    )
    ball = builder.add_body(is_kinematic=True)
    builder.add_shape_sphere(ball, radius=radius, cfg=touch)
    model = builder.finalize(device="cpu")
    model.mpm.young_modulus.fill_(9.0 * bulk * shear / (3.0 * bulk + shear))
    model.mpm.poisson_ratio.fill_((3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear)))
    model.mpm.friction.fill_(0.0)
    model.mpm.yield_stress.fill_(float(scene["yield_stress"]))
    model.mpm.yield_pressure.fill_(1e10)
    model.mpm.tensile_yield_ratio.fill_(1.0)
    config = SolverImplicitMPM.Config()
    config.voxel_size = 2.0 * spacing
    config.max_iterations = 250
    config.tolerance = 1e-6
    solver = SolverImplicitMPM(model, config)
    state = model.state()
    heights = scene["heights"]

    def place(height: float, speed: float) -> None:
        state.body_q.assign([wp.transform((0.0, 0.0, height), wp.quat_identity())])
        state.body_qd.assign([wp.spatial_vector(0.0, 0.0, speed, 0.0, 0.0, 0.0)])

    place(heights[0], 0.0)
    step = frame / STEPS
    positions, forces, cores, walls = [], [], [], []
    height = heights[0]
    for number, target in enumerate(heights):
        speed = (target - height) / frame
        wall, core = time.perf_counter(), time.process_time()
        force = 0.0
        for part in range(STEPS):
            place(height + part * step * speed, speed)
            solver.step(state, state, None, None, step)
            solver.project_outside(state, state, step)
            impulses, _, colliders = solver.collect_collider_impulses(state)
            indices = colliders.numpy()
            bodies = solver.collider_body_index.numpy()[np.maximum(indices, 0)]
            felt = (indices >= 0) & (bodies == ball)
            force += float(impulses.numpy()[felt, 2].sum()) / step / STEPS
        cores.append(time.process_time() - core)
        walls.append(time.perf_counter() - wall)
        forces.append(force)
        height = target
        if number in scene["snapshots"]:
            positions.append(state.particle_q.numpy().copy())
    return {
        "positions": np.array(positions),
        "forces": np.array(forces),
        "core_seconds": np.array(cores),
        "wall_seconds": np.array(walls),
    }


if __name__ == "__main__":
    wp.config.quiet = True
    np.savez(sys.argv[2], **run(dict(np.load(sys.argv[1]))))
