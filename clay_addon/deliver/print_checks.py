# SPDX-License-Identifier: GPL-3.0-or-later
"""Printability of a surface: intersecting triangles, thin walls, and a flat base."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from ..core.surface.exact import Surface, SurfaceError
from .files import triangle_mesh

MAX_RAY_COUNT = 50_000
"""Maximum number of vertices at which walls are measured, evenly sampled: every second one for
100,000 particles, which is still less than a particle spacing apart."""
MAX_UNTANGLING_ROUNDS = 15
"""Maximum number of smoothing rounds; more would deform the shape."""
_MIN_EXIT_COSINE = 0.5
"""Minimum cosine between a ray and the normal at its exit for the distance to count as a wall:
a ray that exits at a grazing angle near an edge does not measure one."""


@dataclass(frozen=True)
class PrintReport:
    """Printability of a surface; lengths in the unit of its vertices."""

    crossings: int
    """Number of intersecting pairs of triangles."""
    thinnest_wall: float
    """Thickness of the thinnest wall."""
    thin_share: float
    """Fraction of the surface area whose wall is thinner than the limit, 0 to 1."""


def check_print(surface: Surface, *, wall: float) -> PrintReport:
    """Check a surface for problems in 3D printing.

    The surface is closed by construction; see `Surface.check`. The thickness of a wall is measured
    along a ray from a vertex straight inward to its exit from the clay.

    Args:
        surface: The surface.
        wall: Thickness of the thinnest printable wall.
    """
    # The tree is single-precision, which is most accurate near the origin at a size of about 1.
    center = surface.vertices.mean(axis=0)
    size = float(np.ptp(surface.vertices, axis=0).max()) or 1.0
    local = (surface.vertices - center) / size
    tree = _tree(local, surface.faces)
    crossings = len(_crossings(tree, local, surface.faces))
    stride = -(-len(local) // MAX_RAY_COUNT)
    samples = np.arange(0, len(local), stride)
    walls = np.array(list(_wall_thicknesses(tree, local[samples], surface.normals[samples])))
    area = _vertex_areas(local, surface.faces)[samples]
    thin = walls < wall / size
    return PrintReport(
        crossings=crossings,
        thinnest_wall=float(walls.min()) * size,
        thin_share=float(area[thin].sum() / area.sum()),
    )


def untangle(surface: Surface) -> Surface:
    """Remove self-intersections of a surface, as in the notch between two balls.

    Vertices around intersecting triangles move halfway to the mean of their neighbors, repeatedly
    until no triangles intersect. The surface stays closed; its volume changes by less than 0.1 %.

    Args:
        surface: A closed surface.

    Returns:
        The surface, unchanged if it has no intersections. Some may remain in layers thinner than
        the particle spacing.
    """
    center = surface.vertices.mean(axis=0)
    size = float(np.ptp(surface.vertices, axis=0).max()) or 1.0
    vertices, faces = (surface.vertices - center) / size, surface.faces
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    moved = False
    for _ in range(MAX_UNTANGLING_ROUNDS):
        pairs = _crossings(_tree(vertices, faces), vertices, faces)
        if not len(pairs):
            break
        near = np.zeros(len(vertices), bool)
        near[faces[pairs].ravel()] = True
        near[end[near[start]]] = True
        # A closed surface has each edge in both directions.
        edges = near[start]
        count = np.bincount(start[edges], minlength=len(vertices))[near, None]
        total = [np.bincount(start[edges], p, len(vertices))[near] for p in vertices[end[edges]].T]
        vertices[near] += (np.stack(total, axis=1) / count - vertices[near]) / 2
        moved = True
    return replace(surface, vertices=vertices * size + center) if moved else surface


def flat_base(surface: Surface, depth: float) -> Surface:
    """Cut off the lowest part of a surface, so that it has a flat base.

    Args:
        surface: A closed surface.
        depth: Height to cut off above its lowest point.

    Returns:
        A closed surface.

    Raises:
        SurfaceError: Nothing remains, or the result is not closed.
    """
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    if not 0 < depth < high[2] - low[2]:
        raise SurfaceError(
            f"A base of {depth:.3g} cannot be cut from clay that is {high[2] - low[2]:.3g} high."
        )
    # Blender's meshes are single-precision, which is most accurate at a size of about 1.
    size = float((high - low).max())
    local = replace(surface, vertices=(surface.vertices - low) / size)
    fault: SurfaceError | None = None
    # The second solver is slower but accepts self-intersecting surfaces.
    for solver in ("MANIFOLD", "EXACT"):
        vertices, faces = _cut(local, depth / size, solver)
        cut = Surface(vertices * size + low, faces)
        try:
            cut.check()
        except SurfaceError as error:
            fault = error
            continue
        colors = None
        if surface.colors is not None:
            colors = surface.colors[_nearest(surface.vertices, cut.vertices)]
        return replace(cut, colors=colors)
    raise SurfaceError(f"No flat base could be cut: {fault}") from fault


def base_area(surface: Surface) -> float:
    """Area of the faces at the lowest height, on which a print stands."""
    heights = surface.vertices[surface.faces][:, :, 2]
    lowest = heights.min()
    tolerance = 1e-5 * (heights.max() - lowest)
    flat = (heights < lowest + tolerance).all(axis=1)
    corners = surface.vertices[surface.faces[flat]]
    sides = corners[:, 1:] - corners[:, :1]
    return float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2)


def _tree(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> BVHTree:
    return BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)


def _crossings(
    tree: BVHTree, vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Pairs of triangles in which an edge of one passes through the other, shape [P, 2]."""
    # The single-precision tree also finds neighbors that only touch.
    found = {(min(pair), max(pair)) for pair in tree.overlap(tree)}
    pairs = np.array(sorted(found), np.int64).reshape(-1, 2)
    crosses = np.zeros(len(pairs), bool)
    corners = vertices[faces]
    for first, second in ((0, 1), (1, 0)):
        edges, (a, b, c) = corners[pairs[:, first]], corners[pairs[:, second]].swapaxes(0, 1)
        for start in range(3):
            p, q = edges[:, start], edges[:, (start + 1) % 3]
            sides = np.stack([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)])
            through = (sides > 0).all(axis=0) | (sides < 0).all(axis=0)
            crosses |= through & (_volume(p, a, b, c) * _volume(q, a, b, c) < 0)
    return pairs[crosses]


def _volume(*corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Six times the signed volume of tetrahedra; 0 if it is too small for a reliable sign."""
    a, b, c, d = corners
    volume = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))
    size = np.abs(np.stack([b - a, c - a, d - a])).max(axis=(0, 2))
    return np.where(np.abs(volume) > 1e-12 * size**3, volume, 0.0)


def _wall_thicknesses(
    tree: BVHTree, points: NDArray[np.float64], normals: NDArray[np.float64]
) -> Iterator[float]:
    """Distance straight through the clay from each point; infinite where there is no wall."""
    # Rays start slightly inside, so that they do not hit their own start.
    skin = 1e-5
    for point, inward in zip((points - skin * normals).tolist(), (-normals).tolist(), strict=True):
        _, normal, _, distance = tree.ray_cast(point, inward)
        if (
            normal is None
            or sum(a * b for a, b in zip(normal, inward, strict=True)) < _MIN_EXIT_COSINE
        ):
            yield np.inf
        else:
            yield distance + skin


def _vertex_areas(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shares = np.repeat(np.linalg.norm(normals, axis=1) / 6, 3)
    return np.bincount(faces.ravel(), shares, minlength=len(vertices))


def _cut(
    surface: Surface, height: float, solver: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of the closed part of a surface above a height."""
    scene = bpy.data.scenes.new("Clay Print")
    mesh, box = triangle_mesh("Clay Print", surface), bpy.data.meshes.new("Clay Print")
    corners = [(x, y, z) for x in (-1.0, 2.0) for y in (-1.0, 2.0) for z in (height, 2.0)]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    box.from_pydata(corners, [], quads)
    items = [bpy.data.objects.new("Clay Print", each) for each in (mesh, box)]
    try:
        for item in items:
            scene.collection.objects.link(item)
        modifier = items[0].modifiers.new("Base", "BOOLEAN")
        modifier.operation, modifier.object, modifier.solver = "INTERSECT", items[1], solver
        with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            depsgraph = bpy.context.evaluated_depsgraph_get()
        evaluated = items[0].evaluated_get(depsgraph)
        result = evaluated.to_mesh()
        result.calc_loop_triangles()
        faces = np.empty((len(result.loop_triangles), 3), np.int32)
        result.loop_triangles.foreach_get("vertices", faces.ravel())
        vertices = np.empty((len(result.vertices), 3), np.float32)
        if len(vertices):
            result.attributes["position"].data.foreach_get("vector", vertices.ravel())
        evaluated.to_mesh_clear()
    finally:
        for item in items:
            bpy.data.objects.remove(item)
        bpy.data.meshes.remove(mesh)
        bpy.data.meshes.remove(box)
        bpy.data.scenes.remove(scene)
    return vertices.astype(np.float64), faces.astype(np.int64)


def _nearest(known: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Index of the known point nearest to each point."""
    from ..core.surface.particle_grid import ParticleGrid

    extent = float(np.ptp(known, axis=0).max())
    best = np.full(len(points), -1)
    # Nearly all points coincide with vertices; only those of the cut are on edges.
    for fraction in (1e-3, 1e-2, 1e-1, 1.0):
        left = np.flatnonzero(best < 0)
        if len(left):
            best[left] = ParticleGrid(known, fraction * extent).nearest(points[left])
    return np.maximum(best, 0)
