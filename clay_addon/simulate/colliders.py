# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders of a simulated scene, at the first frame and later ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.geometry.rotations import rotation_and_stretch
from ...solver.geometry.sheet import sheet_triangles, sheet_vertices
from ..base.mesh_geometry import (
    evaluated_mesh,
    flat_plane,
    is_absent,
    oriented_triangles,
    transform,
)
from ..base.units import to_meters
from ..model.clay_scene import SimulationError, is_enabled
from ..model.collider import ColliderError, resolve_kind
from ..wheel.wheel import is_wheel

if TYPE_CHECKING:
    from ...solver import MeshCollider, Plane


SHEET_THICKNESS = 0.2
"""Of the body around a flat mesh that clay meets from both sides, in spacings."""
_PASSED = 0.1
"""Share of a body's particles that may lie beyond a plane: it stands a little too deep there."""


@dataclass(frozen=True)
class Sheet:
    """A flat mesh that clay meets from both sides."""

    normal: NDArray[np.float64]
    """Of its plane, in the object's coordinates, shape [3]."""
    thickness: float
    """Of the body around it [Blender units]."""


@dataclass
class MovingCollider:
    """A mesh collider, which may move and deform."""

    item: bpy.types.Object
    """The object."""
    vertices: NDArray[np.float64]
    """Local vertices at the first frame [Blender units], shape [V, 3]."""
    triangles: NDArray[np.int32]
    """Triangles, wound outward, shape [F, 3]."""
    stretch: NDArray[np.float64]
    """Of its matrix at the first frame, without its rotation, shape [3, 3]."""
    sheet: Sheet | None = None
    """How a flat mesh becomes a body that clay meets from both sides."""
    handle: MeshCollider | None = None
    """What stands for it in the solver's scene."""
    last: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    """What `state` gave when it was last in the scene."""

    def state(
        self, depsgraph: bpy.types.Depsgraph
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vertices with the object's scale applied [m], and the object's pose without scale [m].

        While it is off in the viewport Blender does not move it, so it stays where it was.

        Raises:
            SimulationError: The collider has changed in a way that the solver does not support.
        """
        if self.last is None or not is_absent(self.item, depsgraph):
            self.last = self._state(depsgraph)
        return self.last

    def _state(
        self, depsgraph: bpy.types.Depsgraph
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scene = depsgraph.scene
        vertices, _ = evaluated_mesh(self.item, depsgraph)
        if vertices.shape != self.vertices.shape:
            raise SimulationError(
                f"{self.item.name!r} has {len(vertices)} vertices at frame "
                f"{scene.frame_current} and {len(self.vertices)} at the first frame. A "
                "collider may deform, but its number of vertices must stay the same."
            )
        matrix = np.array(self.item.evaluated_get(depsgraph).matrix_world, np.float64)
        if not (np.isfinite(vertices).all() and np.isfinite(matrix).all()):
            raise SimulationError(
                f"{self.item.name!r} is not finite (NaN or infinite) at frame "
                f"{scene.frame_current}."
            )
        rotation, stretch = rotation_and_stretch(matrix[:3, :3])
        # Blender's matrices are single precision: without this, a collider that only rotates would
        # seem to deform in every frame.
        if np.allclose(stretch, self.stretch, rtol=0.0, atol=2e-6 * np.abs(stretch).max()):
            stretch = self.stretch
        elif np.linalg.det(stretch) * np.linalg.det(self.stretch) <= 0.0:
            raise SimulationError(
                f"{self.item.name!r} is scaled flat or turned inside out at frame "
                f"{scene.frame_current}. Keep its scale away from zero."
            )
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = to_meters(scene, matrix[:3, 3])
        if self.sheet is not None:
            normal = self.sheet.normal @ np.linalg.inv(stretch)
            vertices = sheet_vertices(
                vertices @ stretch.T, normal / np.linalg.norm(normal), self.sheet.thickness
            )
            return to_meters(scene, vertices), pose
        return to_meters(scene, vertices @ stretch.T), pose


@dataclass
class FlatCollider:
    """An infinite plane, which cannot move."""

    item: bpy.types.Object
    """The object."""
    point: NDArray[np.float64]
    """A point on the plane in world space [Blender units], shape [3]."""
    normal: NDArray[np.float64]
    """Unit normal towards the clay, shape [3]."""
    handle: Plane | None = None
    """What stands for it in the solver's scene."""

    def check(self, depsgraph: bpy.types.Depsgraph, spacing: float) -> None:
        """Refuse a plane that was disabled or moves.

        Args:
            depsgraph: The evaluated scene.
            spacing: Particle spacing [Blender units].

        Raises:
            SimulationError: The plane is disabled or moves; the message names it.
        """
        frame = depsgraph.scene.frame_current
        if not is_enabled(self.item, depsgraph):
            raise SimulationError(
                f"{self.item.name!r} does not touch the clay at frame "
                f"{frame}, but an infinite plane always does. Switch "
                "Touches Clay and the viewport's monitor on, or give it thickness (Solidify "
                "modifier), so that it is a closed mesh."
            )
        vertices, _ = evaluated_mesh(self.item, depsgraph)
        matrix = self.item.evaluated_get(depsgraph).matrix_world
        away = (transform(matrix, vertices) - self.point) @ self.normal
        # The negation also catches NaN.
        if not float(np.abs(away).max()) <= 1e-3 * spacing:
            raise SimulationError(
                f"{self.item.name!r} moves at frame {frame}, but an "
                "infinite plane cannot move. Give it thickness (Solidify modifier), so that "
                "it is a closed mesh."
            )


def read_collider(
    item: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    clay: Mapping[str, NDArray[np.float32]],
    spacing: float,
) -> FlatCollider | MovingCollider:
    """What an object is to the clay, at the current frame.

    A flat mesh is an endless plane where all clay is on one side of it, as on a table. Where there
    is clay on both sides, as above and below a shelf, it is what one sees: a thin sheet.

    Args:
        item: A collider.
        depsgraph: The evaluated scene.
        clay: World positions of each clay object's particles [Blender units], by its name.
        spacing: Distance between particles [Blender units].

    Raises:
        SimulationError: It is no collider, or cuts through clay.
    """
    try:
        kind = resolve_kind(item, item.tactile_clay.collider_kind, depsgraph)
    except ColliderError as error:
        raise SimulationError(str(error)) from error
    vertices, triangles = evaluated_mesh(item, depsgraph)
    matrix = np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
    _, stretch = rotation_and_stretch(matrix[:3, :3])
    if kind == "MESH":
        return MovingCollider(item, vertices, oriented_triangles(matrix, triangles), stretch)
    flat = flat_plane(transform(matrix, vertices))
    assert flat is not None
    point, normal = flat
    if is_wheel(item):
        raise SimulationError(
            f"{item.name!r} has a wheel speed, but an infinite plane stands still. Set the "
            "speed to 0, or give it thickness (Solidify modifier), so that it is a closed mesh."
        )
    heights = {name: (points - point) @ normal for name, points in clay.items()}
    sides = {name: float(np.sign(np.median(each))) for name, each in heights.items()}
    astride = [
        name
        for name, each in heights.items()
        if (each * (sides[name] or 1.0) < -spacing).mean() > _PASSED
    ]
    if len(set(sides.values()) - {0.0}) < 2 and not astride:
        # The free side of a table is the side the clay is on, whichever way its face is turned.
        side = next(iter(set(sides.values()) - {0.0}), 0.0) or float(normal[2])
        return FlatCollider(item, point, normal if side >= 0 else -normal)
    world = transform(matrix, vertices)
    for name in astride:
        if _is_cut(clay[name], heights[name], world[triangles], normal, spacing):
            raise SimulationError(
                f"{item.name!r} cuts through {name!r}: its particles lie on both sides of it. Move "
                "one of them, or cut the clay in two objects (Edit Mode > Point Cloud > Separate)."
            )
    # A plane's normal goes over into the object's coordinates by the transpose.
    own = normal @ matrix[:3, :3]
    own /= np.linalg.norm(own)
    sheet = Sheet(own, SHEET_THICKNESS * spacing)
    faces = sheet_triangles(vertices, triangles, own)
    return MovingCollider(item, vertices, oriented_triangles(matrix, faces), stretch, sheet)


def _is_cut(
    points: NDArray[np.float32],
    heights: NDArray[np.float64],
    corners: NDArray[np.float64],
    normal: NDArray[np.float64],
    spacing: float,
) -> bool:
    """Whether a flat mesh, shape [F, 3, 3], runs through clay: there is some right above and below.

    Clay that is beside it is on both sides of its plane, too.
    """
    near = np.abs(heights) < 1.5 * spacing
    beside = points[near].astype(np.float64)
    over = np.zeros(len(beside), bool)
    for a, b, c in corners:
        inner = np.ones(len(beside), bool)
        turn = np.sign(np.cross(b - a, c - a) @ normal)
        for start, end in ((a, b), (b, c), (c, a)):
            inner &= np.cross(end - start, beside - start) @ normal * turn >= 0.0
        over |= inner
    signs = heights[near][over] > 0.0
    return bool(signs.any() and not signs.all())


def first_shown(item: bpy.types.Object, scene: bpy.types.Scene, last: int) -> int | None:
    """The first frame, from the current one on, at which an object's keys switch it on.

    The scene is at that frame afterwards, or at the last one where it stays off (None).
    """
    for number in range(scene.frame_current, last + 1):
        scene.frame_set(number)
        if not is_absent(item, bpy.context.evaluated_depsgraph_get()):
            return number
    return None
