# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed meshes that become clay: read from objects, checked, and filled with particles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ...solver.geometry.closed_mesh import ClosedMesh, MeshError, closed_mesh, mesh_volume
from ..base.mesh_geometry import (
    SWITCHED_OFF,
    evaluated_mesh,
    is_switched_off,
    oriented_triangles,
    transform,
)
from ..base.units import from_meters, to_meters
from ..core.surface.particle_grid import ParticleGrid

MAX_PARTICLE_COUNT = 1_000_000
"""More particles than this in one object are assumed to be a mistake."""

MIN_PARTICLE_COUNT = 8
"""Fewer particles than this cannot deform like clay."""


class ClayError(TactileClayError):
    """Something cannot become clay; the message says what is wrong and what to do."""


class Piece(NamedTuple):
    """A closed mesh that becomes clay."""

    name: str
    """Name of its object."""
    mesh: ClosedMesh
    """The mesh in world coordinates [Blender units]."""

    @property
    def volume(self) -> float:
        """Its volume [Blender units³]; overlaps between its bodies count twice."""
        return mesh_volume(self.mesh.vertices, self.mesh.faces)


class FilledPieces(NamedTuple):
    """Particles of pieces of clay, and notes for the user."""

    points: list[NDArray[np.float32]]
    """Particle positions of each piece [Blender units], shape [N, 3]."""
    notes: list[str]
    """How meshes were repaired or filled; each is a sentence that names the object."""


def closed_pieces(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> list[Piece]:
    """The closed mesh of each object.

    Raises:
        ClayError: An object cannot become clay; the message names it and the reason.
    """
    pieces = []
    for item in objects:
        if item.type != "MESH":
            already = item.tactile_clay.role == "CLAY"
            what = "is already clay" if already else f"is not a mesh ({item.type.lower()})"
            if item.type == "EMPTY" and item.instance_collection is not None:
                raise ClayError(
                    f"{item.name!r} shows instances of a collection. Convert them to meshes first "
                    "(Object > Apply > Make Instances Real)."
                )
            raise ClayError(f"{item.name!r} {what}. Select closed meshes only.")
        if item.tactile_clay.role == "COLLIDER":
            raise ClayError(
                f"{item.name!r} is a collider. Deselect it, or press Remove Collider first."
            )
        if item.tactile_clay.role == "HAND":
            raise ClayError(
                f"{item.name!r} is a clay hand. Deselect it, or press Remove Clay Hand first."
            )
        if item.library is not None:
            raise ClayError(
                f"{item.name!r} is linked from another file, so it cannot be hidden in renders. "
                "Make it local first (Object > Relations > Make Local)."
            )
        if item.mode == "EDIT":
            raise ClayError(f"{item.name!r} is being edited. Leave Edit Mode first (Tab).")
        if is_switched_off(item, depsgraph):
            raise ClayError(f"{item.name!r} {SWITCHED_OFF}")
        vertices, triangles = evaluated_mesh(item, depsgraph)
        matrix = item.evaluated_get(depsgraph).matrix_world
        try:
            mesh = closed_mesh(
                transform(matrix, vertices),
                oriented_triangles(matrix, triangles),
                name=repr(item.name),
            )
        except MeshError as error:
            raise ClayError(str(error)) from error
        pieces.append(Piece(item.name, mesh))
    return pieces


def check_particle_count(pieces: list[Piece], spacing: float, scene: bpy.types.Scene) -> None:
    """Check that pieces have neither far too many particles nor too few to deform.

    Raises:
        ClayError: They do; the message suggests a spacing.
    """
    volumes = [piece.volume for piece in pieces]
    total = sum(volumes)
    if total / spacing**3 > MAX_PARTICLE_COUNT:
        raise ClayError(
            f"That would be {_about(total / spacing**3)} particles; the maximum is "
            f"{MAX_PARTICLE_COUNT:,}. Use a spacing of at least "
            f"{_length(_rounded(total / MAX_PARTICLE_COUNT, up=True), scene)}, or check the "
            "size of the meshes."
        )
    for (name, _), volume in zip(pieces, volumes, strict=True):
        if round(volume / spacing**3) < MIN_PARTICLE_COUNT:
            raise ClayError(
                f"{name!r} is too small for a spacing of {_length(spacing, scene)}: it would have "
                f"{round(volume / spacing**3)} particles. Use a spacing of at most "
                f"{_length(_rounded(volume / 200, up=False), scene)}, or a larger mesh."
            )


def check_place(pieces: list[Piece], spacing: float) -> None:
    """Check that pieces are close enough to the origin for single precision.

    Raises:
        ClayError: One is not; the message names the object.
    """
    for name, mesh in pieces:
        # The resolution of single precision at the largest coordinate.
        if np.spacing(np.float32(np.abs(mesh.vertices).max())) > 0.01 * spacing:
            raise ClayError(
                f"{name!r} is too far from the world origin: its particle positions would not be "
                "precise enough. Move it closer to the origin."
            )


def fill_pieces(
    pieces: list[Piece],
    spacing: float,
    scene: bpy.types.Scene,
    *,
    follow_thin_walls: bool = False,
) -> FilledPieces:
    """Fill each piece with particles, except where an earlier piece already has some.

    Args:
        pieces: The pieces.
        spacing: Distance between particles [Blender units].
        scene: The scene whose unit scale applies.
        follow_thin_walls: Whether walls too thin for the spacing get one layer of particles.

    Raises:
        ClayError: A piece cannot be filled.
    """
    from ...solver.geometry.fill import fill

    # In meters, as lengths in the solver's messages are.
    filled: list[NDArray[np.float32]] = []
    notes = []
    for index, (name, mesh) in enumerate(pieces):
        in_meters = replace(mesh, vertices=to_meters(scene, mesh.vertices))
        try:
            filling = fill(
                in_meters,
                to_meters(scene, spacing),
                name=repr(name),
                follow_thin_walls=follow_thin_walls,
            )
        except (MeshError, ValueError) as error:
            raise ClayError(str(error)) from error
        points = from_meters(scene, filling.points.astype(np.float64))
        for (_, other), particles in zip(pieces[:index], filled, strict=True):
            points = points[~_occupied(points, other, particles, spacing)]
        filled.append(points.astype(np.float32))
        notes += [f"{name!r}: {note}" for note in filling.notes]
    return FilledPieces(filled, notes)


def _occupied(
    points: NDArray[np.float64],
    mesh: ClosedMesh,
    particles: NDArray[np.float32],
    spacing: float,
) -> NDArray[np.bool_]:
    """Mask of the points inside a mesh, or within half a spacing of its particles, shape [N]."""
    from ...solver.geometry.inside import is_inside

    taken = np.zeros(len(points), bool)
    low, high = mesh.vertices.min(0) - spacing, mesh.vertices.max(0) + spacing
    near = np.flatnonzero((points >= low).all(1) & (points <= high).all(1))
    if not len(near) or not len(particles):
        return taken
    grid = ParticleGrid(particles.astype(np.float64), 0.5 * spacing)
    taken[near] = grid.nearest(points[near]) >= 0
    left = near[~taken[near]]
    taken[left] = is_inside(points[left], mesh)
    return taken


def _rounded(cell_volume: float, *, up: bool) -> float:
    """Edge length of a cubic cell, rounded to two digits."""
    edge = cell_volume ** (1 / 3)
    step = 10.0 ** (math.floor(math.log10(edge)) - 1)
    # The tolerance keeps round values round despite single precision.
    return (math.ceil(edge / step - 1e-4) if up else math.floor(edge / step + 1e-4)) * step


def _about(count: float) -> str:
    step = 10 ** max(0, math.floor(math.log10(count)) - 2)
    return f"{round(count / step) * step:,}"


def _length(value: float, scene: bpy.types.Scene) -> str:
    meters = to_meters(scene, value)
    if meters >= 1:
        return f"{meters:.3g} m"
    return f"{meters * 1e3:.3g} mm"
