# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of the clay's surface while it is worked, and its distance from a ball and a block."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_clay.clay_addon.core.surface.exact import Surface, reconstruct
from tactile_clay.clay_addon.core.surface.quick.surface import QuadSurface, QuickSurface

SIZES = {
    "2k": (13, 13, 13),
    "4k": (16, 16, 16),
    "20k": (27, 27, 27),
    "100k": (50, 50, 40),
}
"""Number of particles along each side of the blocks."""
DISORDER = 0.08
"""Disorder of worked clay: standard deviation of each coordinate, in spacings."""
MAX_EXACT = 20_000
"""Largest number of particles for which the exact surface is made for comparison."""


@dataclass(frozen=True)
class SurfaceFigures:
    """Cost and error of surfaces of one size, with lengths in spacings."""

    size: str
    particles: int
    vertices: int
    ms_median: float
    """Time of a frame in which all clay moves, on one thread."""
    ms_p90: float
    core_ms: float
    """Processor time of the thread, less affected by other work on the machine."""
    still_ms: float
    """Time of a frame in which nothing moves."""
    write_ms: float | None
    """Time to write it into a Blender mesh, on Blender's thread; None without Blender."""
    exact_ms: float | None
    """Time of the exact surface, for comparison; None if not made."""
    ball_volume: float
    """Volume of the ball's surface over that of the particles."""
    ball_distance: float
    """RMS distance of the vertices from the ball."""
    block_volume: float
    block_distance: float


def measure_surface(size: str, *, frames: int = 15) -> SurfaceFigures:
    """Time surfaces of a block with a running wave, and judge those of a ball and a block.

    Args:
        size: One of `SIZES`.
        frames: Number of timed frames.
    """
    counts = SIZES[size]
    block = _lattice(*counts)
    noise = np.random.default_rng(0).normal(0.0, DISORDER, block.shape)
    colors = np.where(block[:, :1] < 0, (0.6, 0.02, 0.02, 1.0), (0.02, 0.1, 0.6, 1.0))
    quick = QuickSurface(1.0)
    wall, core = [], []
    for frame in range(frames + 2):
        points = (block + noise).astype(np.float32)
        points[:, 2] += 0.3 * np.sin(0.5 * points[:, 0] + 0.4 * frame)
        began, busy = time.perf_counter(), time.thread_time()
        surface = quick.reconstruct(points, colors)
        wall.append(1e3 * (time.perf_counter() - began))
        core.append(1e3 * (time.thread_time() - busy))
    still = _milliseconds(lambda: quick.reconstruct(points, colors), 5)
    exact = None
    if len(block) <= MAX_EXACT:
        exact = _milliseconds(lambda: reconstruct(points, 1.0, colors=colors), 1)
    ball = _ball(len(block))
    round_one = quick.reconstruct(ball + noise, colors)
    square_one = quick.reconstruct(block + noise, colors)
    radius = np.cbrt(3.0 * len(ball) / (4.0 * np.pi))
    from_ball = np.linalg.norm(round_one.vertices, axis=1) - radius
    return SurfaceFigures(
        size=size,
        particles=len(block),
        vertices=len(surface.vertices),
        ms_median=float(np.median(wall[2:])),
        ms_p90=float(np.percentile(wall[2:], 90)),
        core_ms=float(np.median(core[2:])),
        still_ms=still,
        write_ms=_write_milliseconds(surface),
        exact_ms=exact,
        ball_volume=_volume(round_one) / len(ball),
        ball_distance=_root_mean_square(from_ball),
        block_volume=_volume(square_one) / len(block),
        block_distance=_root_mean_square(_from_block(square_one.vertices, np.array(counts))),
    )


def surface_lines(results: list[SurfaceFigures]) -> list[str]:
    """Table of the results in Markdown."""
    lines = [
        "A block in which all clay moves, on one thread; errors are those of a ball and a block of "
        "as many particles, disordered by 0.08 of their spacing d.",
        "",
        "| particles | ms per surface | core-ms | nothing moves | into Blender | exact surface "
        "| ball: volume, distance | block: volume, distance |",
        "|---" * 8 + "|",
    ]
    for r in results:
        lines.append(
            f"| {r.particles:,} | {r.ms_median:.1f} | {r.core_ms:.1f} | {r.still_ms:.2f} "
            f"| {_number(r.write_ms)} | {_number(r.exact_ms)} "
            f"| {r.ball_volume - 1:+.1%}, {r.ball_distance:.3f} d "
            f"| {r.block_volume - 1:+.1%}, {r.block_distance:.3f} d |"
        )
    return lines


def _number(value: float | None) -> str:
    return "—" if value is None else f"{value:.1f}"


def _milliseconds(work: Callable[[], object], times: int) -> float:
    taken = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        taken.append(1e3 * (time.perf_counter() - began))
    return float(np.median(taken))


def _write_milliseconds(surface: QuadSurface) -> float | None:
    if importlib.util.find_spec("bpy") is None:
        return None
    import bpy

    from tactile_clay.clay_addon.base.surface_mesh import fill_surface_mesh

    mesh = bpy.data.meshes.new("Timed")

    def write() -> None:
        fill_surface_mesh(
            mesh,
            surface.vertices,
            surface.faces,
            spacing=1.0,
            colors=surface.colors,
            edges=surface.edges,
            face_edges=surface.face_edges,
        )

    taken = _milliseconds(write, 7)
    bpy.data.meshes.remove(mesh)
    return taken


def _lattice(*counts: int) -> NDArray[np.float64]:
    axes = [np.arange(count) - (count - 1) / 2 for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _ball(count: int) -> NDArray[np.float64]:
    """The ``count`` particles of a lattice nearest to its center."""
    points = _lattice(*[round(1.4 * np.cbrt(count)) | 1] * 3)
    return points[np.argsort(np.linalg.norm(points, axis=1), kind="stable")[:count]]


def _volume(surface: QuadSurface) -> float:
    return Surface(surface.vertices.astype(np.float64), surface.triangles).volume


def _from_block(vertices: NDArray[np.float32], sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """Distance from the surface of a block."""
    beyond = np.abs(vertices) - sides / 2
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.where(outside > 0, outside, np.abs(beyond.max(axis=1)))


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))
