# SPDX-License-Identifier: GPL-3.0-or-later
"""The clay that a scene shows at any frame: baked, packed, keyed or sculpted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..base.clock import animation_time
from ..base.keyed_channels import find_curve
from ..base.mesh_geometry import transform
from ..core.storage.cache import Cache
from ..core.storage.playback import Playback, shown_frame
from ..core.surface.exact import Surface, reconstruct
from ..model.clay_points import is_sculpted, present_rows
from ..model.clay_scene import clay_colors, read_points
from .packed import is_packed, packed_positions
from .playback import is_bake_of
from .poses import pose_at


class ShownClayError(TactileClayError, ValueError):
    """The clay has no shape at a frame; the message says why and what to do."""


@dataclass(frozen=True)
class ShownParticles:
    """Particles of a clay object in world space."""

    positions: NDArray[np.float64]
    """Positions [Blender units, or another unit after `scaled`], shape [N, 3]."""
    colors: NDArray[np.float32]
    """Linear RGBA, 0..1, shape [N, 4]."""
    velocities: NDArray[np.float32]
    """Velocities [unit of the positions/s], shape [N, 3]; 0 for a held shape."""
    spacing: float
    """Distance between neighbors [unit of the positions]."""

    def scaled(self, scale: float) -> ShownParticles:
        """The particles with all lengths multiplied by a factor, to change the unit."""
        return replace(
            self,
            positions=self.positions * scale,
            velocities=self.velocities * np.float32(scale),
            spacing=self.spacing * scale,
        )


class ShownClay:
    """Reads the particles that clay objects show, frame by frame.

    Objects that move (see `moves`) are read with their transform at the scene's current frame.

    Args:
        scene: The scene.
        objects: The clay objects.
        cache: The bake that they play, or None.

    Raises:
        ShownClayError: An object is not clay, or is scaled to zero.
        CacheError: The cache cannot be read.
    """

    def __init__(
        self, scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], cache: Cache | None
    ) -> None:
        self._scene = scene
        self._objects = list(objects)
        self._spacings = [world_spacing(item) for item in objects]
        self._playback: Playback | None = None
        self.baked: list[int] = []
        """Numbers of the baked frames, sorted; empty if the clay plays no bake."""
        self.sculpted = False
        """Whether the clay was sculpted since it was baked, and so does not play the bake."""
        if cache is not None and cache.exists() and not all(is_packed(item) for item in objects):
            playback = Playback(cache)
            if is_bake_of(playback.meta(), self._objects):
                self.sculpted = any(is_sculpted(item) for item in objects)
                if not self.sculpted:
                    self._playback, self.baked = playback, playback.frames()

    def key(self, number: int) -> tuple[tuple[object, ...], ...]:
        """Identifies the shape at a frame: frames with equal keys show the same particles."""
        return tuple(self._key(item, number) for item in self._objects)

    def read(self, number: float) -> list[ShownParticles]:
        """The particles of each object at a frame, in Blender units.

        Args:
            number: Frame number.

        Raises:
            ShownClayError: An object has no particles, or the frame is missing in the bake.
            CacheError: The frame is damaged.
        """
        if self._playback is None or not any(
            self._is_baked(item, number) for item in self._objects
        ):
            return [
                self._read_own(item, spacing, number)
                for item, spacing in zip(self._objects, self._spacings, strict=True)
            ]
        wanted = self._baked_frame(number)
        if wanted not in self.baked:
            raise ShownClayError(f"Frame {wanted} is missing in the bake. Press Resume.")
        frame = self._playback.frame(wanted)
        held = self._scene.tactile_clay.hold_frames > 1
        velocities = [np.zeros_like(each) if held else each for each in frame.velocities]
        return [
            _present(item, positions, motion, spacing, np.eye(4))
            if self._is_baked(item, number)
            else self._read_own(item, spacing, number)
            for item, spacing, positions, motion in zip(
                self._objects,
                self._spacings,
                frame.positions,
                velocities,
                strict=True,
            )
        ]

    def _is_baked(self, item: bpy.types.Object, number: float) -> bool:
        return bool(self.baked) and not is_packed(item) and self._pose(item, number) is None

    def _pose(self, item: bpy.types.Object, number: float) -> bpy.types.Object | None:
        return pose_at(item, animation_time(self._scene, number))

    def _baked_frame(self, number: float) -> int:
        return shown_frame(
            self.baked, math.floor(number), hold=self._scene.tactile_clay.hold_frames
        )

    def _key(self, item: bpy.types.Object, number: int) -> tuple[object, ...]:
        pose = self._pose(item, number)
        where = (number,) if moves(item) else ()
        if pose is not None:
            return ("pose", pose.name, *where)
        if is_packed(item):
            return ("packed", number)
        return ("baked", self._baked_frame(number)) if self.baked else ("own", *where)

    def _read_own(self, item: bpy.types.Object, spacing: float, number: float) -> ShownParticles:
        """Particles of a keyed, packed or sculpted shape, which goes with its object."""
        pose = self._pose(item, number)
        if pose is None and is_packed(item):
            local: NDArray[np.float32] | None = packed_positions(item, number)
        else:
            local = read_points(pose or item, "position")
        if local is None or len(local) == 0:
            raise ShownClayError(f"{item.name!r} has no particles.")
        still = np.zeros((len(local), 3), np.float32)
        return _present(pose or item, local, still, spacing, item.matrix_world)


def _present(
    held: bpy.types.Object,
    positions: NDArray[np.float32],
    velocities: NDArray[np.float32],
    spacing: float,
    matrix: Any,
) -> ShownParticles:
    """The particles of a clay object that are present."""
    there = present_rows(held, positions)
    return ShownParticles(
        transform(matrix, positions[there]), clay_colors(held)[there], velocities[there], spacing
    )


def moves(item: bpy.types.Object) -> bool:
    """Whether a clay object's transform may change: keyed, driven, constrained or parented.

    A bake is in world space, but keyed, packed and sculpted shapes move with their object.
    """
    animation = item.animation_data
    if item.parent is not None or len(item.constraints) or item.rigid_body is not None:
        return True
    if animation is None:
        return False
    if animation.nla_tracks:
        return True
    paths = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
    places = {prefix + path for prefix in ("", "delta_") for path in paths}
    driven = any(curve.data_path in places for curve in animation.drivers)
    return driven or any(find_curve(item, path) for path in places)


def world_spacing(item: bpy.types.Object) -> float:
    """Distance between the particles of a clay object in world space [Blender units].

    Raises:
        ShownClayError: The object is not clay, or is scaled to zero.
    """
    if item.type != "POINTCLOUD":
        raise ShownClayError(f"{item.name!r} is a {item.type.lower()}, not clay.")
    spacing = getattr(getattr(item, "tactile_clay", None), "spacing", 0.0)
    if not spacing > 0:
        radius = item.data.attributes.get("radius")
        spacing = 2 * radius.data[0].value if radius and len(radius.data) else 0.0
    if not spacing > 0:
        raise ShownClayError(f"{item.name!r} has no particle spacing. Make the clay again.")
    matrix = np.array(item.matrix_world, np.float64)
    stretch = np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    if not stretch > 0:
        raise ShownClayError(f"{item.name!r} is scaled to zero. Give it a scale above 0.")
    return float(spacing * stretch)


def particles_surface(
    parts: Sequence[ShownParticles], *, moving: bool = False
) -> tuple[Surface, int, float]:
    """Reconstruct the surface of clay; touching objects with the same spacing become one piece.

    Args:
        parts: The particles of each object.
        moving: Whether the surface gets velocities.

    Returns:
        The surface, the number of particles, and their volume [unit of the positions, cubed].

    Raises:
        SurfaceError: The particles have no surface.
        ImportError: pysplashsurf is missing.
    """
    groups: dict[float, list[ShownParticles]] = {}
    for part in parts:
        # Rounded, as equal spacings may differ through single precision in the properties.
        groups.setdefault(float(f"{part.spacing:.5g}"), []).append(part)
    surfaces = [
        reconstruct(
            np.concatenate([part.positions for part in group]),
            spacing,
            colors=np.concatenate([part.colors for part in group]),
            velocities=np.concatenate([part.velocities for part in group]) if moving else None,
        )
        for spacing, group in groups.items()
    ]
    count = sum(len(part.positions) for part in parts)
    volume = sum(len(p.positions) * spacing**3 for spacing, g in groups.items() for p in g)
    return _joined(surfaces), count, volume


def _joined(surfaces: Sequence[Surface]) -> Surface:
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    colors = [surface.colors for surface in surfaces if surface.colors is not None]
    velocities = [surface.velocities for surface in surfaces if surface.velocities is not None]
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate(
            [surface.faces + start for surface, start in zip(surfaces, starts, strict=False)]
        ),
        np.concatenate(colors) if colors else None,
        np.concatenate(velocities) if velocities else None,
    )
