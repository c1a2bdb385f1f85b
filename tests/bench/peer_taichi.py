# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the comparison scene in a moving-least-squares material point method written in Taichi.

Taichi is a language; the method is set up like the examples in its documentation (mpm99, mpm3d):
explicit steps, quadratic B-splines, affine transfer, eight particles per cell, float32. The clay is
Hencky elasticity with von Mises yield by return mapping (Klár et al., *Drucker-Prager
elastoplasticity for sand animation*, ACM TOG 2016, doi 10.1145/2897824.2925906, has the mapping in
logarithmic strain). Contact is with grid nodes inside the ball or the table, with Coulomb friction;
the force on the ball is the momentum that those nodes lose.

    python peer_taichi.py scene.npz result.npz
"""

import sys
import time
from typing import Any

import numpy as np
import taichi as ti

COURANT = 0.3
"""Fraction of a cell that a pressure wave crosses in a step."""
MARGIN = 4
"""Empty cells below the table and around the block."""

ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=ti.f32, offline_cache=False)


@ti.data_oriented
class MaterialPoints:
    """Clay between a table at z = 0 and a ball over the origin."""

    def __init__(self, scene: dict[str, np.ndarray]) -> None:
        spacing, points = float(scene["spacing"]), scene["points"]
        self.cell = 2.0 * spacing
        self.radius = float(scene["radius"])
        self.friction = float(scene["friction"])
        self.shear = float(scene["shear_modulus"])
        self.lame = float(scene["bulk_modulus"]) - 2.0 / 3.0 * self.shear
        self.yield_stress = float(scene["yield_stress"])
        self.volume = spacing**3
        self.mass = float(scene["density"]) * self.volume
        wave = np.sqrt((self.lame + 2.0 * self.shear) / float(scene["density"]))
        frame = float(scene["frame"])
        self.steps = int(np.ceil(frame * wave / (COURANT * self.cell)))
        self.step = frame / self.steps
        size = np.ptp(points, axis=0) + spacing
        wide = int(np.ceil(2.0 * size[0] / self.cell)) + 2 * MARGIN
        tall = int(np.ceil(1.5 * size[2] / self.cell)) + 2 * MARGIN
        self.corner = ti.Vector([-0.5 * wide * self.cell] * 2 + [-MARGIN * self.cell])
        count = len(points)
        self.x = ti.Vector.field(3, ti.f32, count)
        self.v = ti.Vector.field(3, ti.f32, count)
        self.affine = ti.Matrix.field(3, 3, ti.f32, count)
        self.elastic = ti.Matrix.field(3, 3, ti.f32, count)
        self.grid_v = ti.Vector.field(3, ti.f32, (wide, wide, tall))
        self.grid_m = ti.field(ti.f32, (wide, wide, tall))
        self.impulse = ti.field(ti.f32, ())
        self.x.from_numpy(points.astype(np.float32))
        self.elastic.from_numpy(np.tile(np.eye(3, dtype=np.float32), (count, 1, 1)))

    @ti.func
    def stencil(self, x):  # type: ignore[no-untyped-def]
        """First node, position relative to it, and weights along each axis."""
        place = (x - self.corner) / self.cell
        base = ti.cast(place - 0.5, ti.i32)
        f = place - ti.cast(base, ti.f32)
        weights = ti.Matrix.rows(
            [0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2]
        )
        return base, f, weights

    @ti.func
    def stress(self, p):  # type: ignore[no-untyped-def]
        """Kirchhoff stress after the return mapping, which shortens the elastic strain."""
        u, sigma, v = ti.svd(self.elastic[p])
        strain = ti.Vector([ti.log(ti.max(sigma[n, n], 0.05)) for n in ti.static(range(3))])
        mean = strain.sum() / 3.0
        shape = strain - mean
        limit = self.yield_stress / (ti.sqrt(2.0) * self.shear)
        size = shape.norm()
        if size > limit:
            shape *= limit / size
            strain = shape + mean
            stretch = ti.Matrix.zero(ti.f32, 3, 3)
            for n in ti.static(range(3)):
                stretch[n, n] = ti.exp(strain[n])
            self.elastic[p] = u @ stretch @ v.transpose()
        tau = ti.Matrix.zero(ti.f32, 3, 3)
        for n in ti.static(range(3)):
            tau[n, n] = 2.0 * self.shear * strain[n] + self.lame * strain.sum()
        return u @ tau @ u.transpose()

    @ti.kernel
    def advance(self, height: ti.f32, speed: ti.f32):  # type: ignore[no-untyped-def, valid-type]
        """Advance by one step, given the height of the ball's center [m] and its speed [m/s]."""
        for node in ti.grouped(self.grid_m):
            self.grid_v[node] = ti.Vector.zero(ti.f32, 3)
            self.grid_m[node] = 0.0
        for p in self.x:
            self.elastic[p] += self.step * self.affine[p] @ self.elastic[p]
            base, f, weights = self.stencil(self.x[p])
            push = -self.step * self.volume * 4.0 / self.cell**2 * self.stress(p)
            push += self.mass * self.affine[p]
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                arm = (ti.Vector([i, j, k]) - f) * self.cell
                w = weights[i, 0] * weights[j, 1] * weights[k, 2]
                self.grid_v[base + ti.Vector([i, j, k])] += w * (self.mass * self.v[p] + push @ arm)
                self.grid_m[base + ti.Vector([i, j, k])] += w * self.mass
        for node in ti.grouped(self.grid_m):
            m = self.grid_m[node]
            if m > 0.0:
                v = self.grid_v[node] / m
                v[2] -= 9.81 * self.step
                place = self.corner + self.cell * ti.cast(node, ti.f32)
                if place[2] <= 0.0:
                    v = self.touch(v, ti.Vector([0.0, 0.0, 1.0]))
                arm = place - ti.Vector([0.0, 0.0, height])
                if arm.norm() < self.radius:
                    ball = ti.Vector([0.0, 0.0, speed])
                    after = ball + self.touch(v - ball, arm.normalized(1e-9))
                    self.impulse[None] += m * (v[2] - after[2])
                    v = after
                self.grid_v[node] = v
        for p in self.x:
            base, f, weights = self.stencil(self.x[p])
            v = ti.Vector.zero(ti.f32, 3)
            affine = ti.Matrix.zero(ti.f32, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                w = weights[i, 0] * weights[j, 1] * weights[k, 2]
                near = self.grid_v[base + ti.Vector([i, j, k])]
                v += w * near
                affine += 4.0 * w / self.cell * near.outer_product(ti.Vector([i, j, k]) - f)
            self.v[p], self.affine[p] = v, affine
            self.x[p] += self.step * v

    @ti.func
    def touch(self, v, normal):  # type: ignore[no-untyped-def]
        """Stop motion into a surface, with Coulomb friction."""
        into = v.dot(normal)
        result = v
        if into < 0.0:
            along = v - into * normal
            size = along.norm()
            result = along * ti.max(0.0, 1.0 + self.friction * into / ti.max(size, 1e-9))
        return result


def run(scene: dict[str, np.ndarray]) -> dict[str, Any]:
    """Run the scene."""
    clay = MaterialPoints(scene)
    heights, frame = scene["heights"], float(scene["frame"])
    positions, forces, cores, walls = [], [], [], []
    height = heights[0]
    for number, target in enumerate(heights):
        speed = (target - height) / frame
        wall, core = time.perf_counter(), time.process_time()
        clay.impulse[None] = 0.0
        for part in range(clay.steps):
            clay.advance(height + part * clay.step * speed, speed)
        ti.sync()
        cores.append(time.process_time() - core)
        walls.append(time.perf_counter() - wall)
        # The upward momentum that the clay loses is the ball's gain.
        forces.append(clay.impulse[None] / frame)
        height = target
        if number in scene["snapshots"]:
            positions.append(clay.x.to_numpy())
    return {
        "positions": np.array(positions),
        "forces": np.array(forces),
        "core_seconds": np.array(cores),
        "wall_seconds": np.array(walls),
    }


if __name__ == "__main__":
    np.savez(sys.argv[2], **run(dict(np.load(sys.argv[1]))))
