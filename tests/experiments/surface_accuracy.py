# SPDX-License-Identifier: GPL-3.0-or-later
"""Distance of clay surfaces from the shapes that were filled, and their cost.

``python -m tactile_clay.tests.experiments.surface_accuracy`` prints the table.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
import trimesh
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from tactile_clay.clay_addon.base.mesh_geometry import evaluated_mesh
from tactile_clay.clay_addon.clay.look import add_look, set_input
from tactile_clay.clay_addon.core.surface.exact import Surface, reconstruct
from tactile_clay.clay_addon.model.point_cloud import make_point_cloud
from tactile_clay.solver import fill_mesh

SPACINGS = (0.002, 0.0035, 0.005, 0.007)
RADIUS = 0.03
"""Radius of the sphere [m]."""
SIDES = np.array([0.06, 0.05, 0.04])
"""Approximate sides of the box [m], rounded to whole spacings."""
SAMPLES = 20_000


@dataclass(frozen=True)
class Accuracy:
    """Distance of a surface from the shape that it represents."""

    particles: int
    """Number of particles."""
    rms: float
    """RMS distance in both directions [m]."""
    hausdorff: float
    """Largest distance in both directions [m]."""
    volume_error: float
    """Relative error of the volume."""
    seconds: float
    """Processor time of the surface, summed over cores [s]."""


def exact_surface(points: NDArray[np.float64], spacing: float) -> Surface:
    """The surface that is exported and delivered."""
    colors = np.ones((len(points), 4), np.float32)
    return reconstruct(points, spacing, colors=colors)


def nodes_surface(points: NDArray[np.float64], spacing: float) -> Surface:
    """The surface that the look's geometry nodes show."""
    colors = np.ones((len(points), 4), np.float32)
    item = make_point_cloud(bpy.context, points.astype(np.float32), colors, spacing, "Clay")
    modifier = add_look(item, spacing=spacing)
    set_input(modifier, "Viewport Limit", 10**7)
    vertices, faces = _evaluated(item)
    bpy.data.objects.remove(item)
    return Surface(vertices, faces.astype(np.int64))


def _evaluated(item: Any) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    geometry = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    shown = bpy.data.objects.new("Shown", geometry.mesh.copy())
    bpy.context.scene.collection.objects.link(shown)
    mesh = evaluated_mesh(shown, bpy.context.evaluated_depsgraph_get())
    bpy.data.objects.remove(shown)
    return mesh


SURFACES: dict[str, Callable[[NDArray[np.float64], float], Surface]] = {
    "exact": exact_surface,
    "geometry nodes": nodes_surface,
}


SHAPES = ("sphere", "box")


def sides(spacing: float) -> NDArray[np.float64]:
    """Sides of the box, a whole number of spacings each [m], shape [3]."""
    return np.round(SIDES / spacing) * spacing


def shape_mesh(name: str, spacing: float) -> trimesh.Trimesh:
    """Mesh of the shape to fill."""
    if name == "sphere":
        return trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    return trimesh.creation.box(sides(spacing))


def distance_to(name: str, points: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Distance of points from the exact sphere or box [m], shape [N]."""
    if name == "sphere":
        return np.abs(np.linalg.norm(points, axis=1) - RADIUS)
    beyond = np.abs(points) - sides(spacing) / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.abs(outside + np.minimum(beyond.max(axis=1), 0))


def measure(kind: str, shape: str, spacing: float) -> Accuracy:
    """Fill a shape, make its surface, and compare the two.

    Args:
        kind: One of `SURFACES`.
        shape: One of `SHAPES`.
        spacing: Particle spacing [m].
    """
    mesh = shape_mesh(shape, spacing)
    filled = fill_mesh(mesh.vertices, mesh.faces.astype(np.int32), spacing)
    points = np.asarray(filled, np.float64)
    began = time.process_time()
    surface = SURFACES[kind](points, spacing)
    seconds = time.process_time() - began
    # Points are sampled evenly by area, unlike vertices.
    made = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    on_surface, _ = trimesh.sample.sample_surface(made, SAMPLES, seed=0)
    there = distance_to(shape, on_surface, spacing)
    on_shape, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=1)
    if shape == "sphere":
        on_shape *= RADIUS / np.linalg.norm(on_shape, axis=1, keepdims=True)
    tree = BVHTree.FromPolygons(surface.vertices.tolist(), surface.faces.tolist())
    back = np.array([tree.find_nearest(point)[3] for point in on_shape.tolist()])
    true_volume = 4 / 3 * np.pi * RADIUS**3 if shape == "sphere" else float(np.prod(sides(spacing)))
    return Accuracy(
        particles=len(points),
        rms=float(np.sqrt(np.mean(np.concatenate([there, back]) ** 2))),
        hausdorff=float(max(there.max(), back.max())),
        volume_error=surface.volume / true_volume - 1,
        seconds=seconds,
    )


def surface_lines(spacings: tuple[float, ...] = SPACINGS) -> list[str]:
    """Measure all surfaces, shapes and spacings.

    Returns:
        Lines of Markdown.
    """
    lines = [
        "A sphere of 30 mm radius and a box of about 60 × 50 × 40 mm, filled with clay at several "
        "spacings d, and the distance of their surfaces from them: root mean square and largest "
        "(Hausdorff), in both directions. *Exact* is what is exported and delivered, *geometry "
        "nodes* what the viewport and renders of the point cloud show.",
        "",
        "| shape | d, mm | particles | surface | rms, mm | rms / d | Hausdorff, mm "
        "| Hausdorff / d | volume | processor s |",
        "|---" * 10 + "|",
    ]
    for shape in SHAPES:
        for spacing in spacings:
            for kind in SURFACES:
                found = measure(kind, shape, spacing)
                lines.append(
                    f"| {shape} | {1e3 * spacing:g} | {found.particles:,} | {kind} "
                    f"| {1e3 * found.rms:.3f} | {found.rms / spacing:.3f} "
                    f"| {1e3 * found.hausdorff:.2f} | {found.hausdorff / spacing:.2f} "
                    f"| {found.volume_error:+.2%} | {found.seconds:.2f} |"
                )
    return lines


if __name__ == "__main__":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    print("\n".join(surface_lines()), flush=True)
