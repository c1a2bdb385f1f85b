# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools of the character scene: colliders whose keyframes press them into the clay."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..model.collider import make_collider
from .parts import Vec3, mesh_object, plain_material

_CLEARANCE = 0.03
"""Distance from the clay at which a press starts and ends [m]."""
_PARKED = Vector((0.45, -0.05, 0.30))
"""Where idle tools of her left side are, out of the picture [m]; the others are mirrored."""
_TRAVEL_FRAMES = 16
"""Number of frames from there to the clay."""
_HANDLE = 0.10
"""Length of a tool's handle, which does not touch the clay [m]."""

Spot = tuple[Vector, Vector]
"""A point on the clay [m], and the outward direction there."""


class ModelingTool:
    """A collider whose motion is a series of presses.

    Args:
        context: Its collection gets the tool.
        name: Name of the object.
        shape: Vertices in the tool's coordinates, as in the presets [m], and faces.
        friction: Coulomb friction coefficient.
        color: Linear RGB.
        handle: Radius of the handle [m]; 0 for none.
    """

    def __init__(
        self,
        context: bpy.types.Context,
        name: str,
        shape: tuple[NDArray[np.float64], Sequence | NDArray],
        *,
        friction: float,
        color: Vec3,
        handle: float = 0.0,
    ) -> None:
        self._keys: list[tuple[int, Vector, Vector]] = []
        vertices, faces = shape
        self.item = mesh_object(name, vertices, faces)
        self.item.data.shade_smooth()
        self.item.data.materials.append(plain_material(name, color, 0.35))
        self.item.rotation_mode = "QUATERNION"
        context.view_layer.update()
        make_collider(self.item, "MESH", friction)
        if handle:
            _add_handle(self.item, float(vertices[:, 2].max()), handle)

    def press(self, spot: Spot, depth: float, frames: tuple[int, int, int, int]) -> None:
        """Press the tool into the clay and pull it straight back out.

        Args:
            spot: Where to press.
            depth: Depth of its tip below the spot [m]; if negative, it stays above.
            frames: When it starts to move in, is fully in, starts to move out, and is out.
        """
        place, out = spot
        away = place + _CLEARANCE * out
        tip = place - depth * out
        for frame, where in zip(frames, (away, tip, tip, away), strict=True):
            self._key(frame, where, out)

    def write(self) -> bpy.types.Object:
        """Insert the keyframes: all presses, and before and after them a wait out of the picture.

        Returns:
            The tool's object.
        """
        keys = sorted(self._keys, key=lambda key: key[0])
        side = 1.0 if keys[0][1].x > -1e-3 else -1.0
        parked = Vector((side * _PARKED.x, _PARKED.y, _PARKED.z))
        start, end = keys[0][0] - _TRAVEL_FRAMES, keys[-1][0] + _TRAVEL_FRAMES
        for frame, place, out in ((start, parked, keys[0][2]), *keys, (end, parked, keys[-1][2])):
            turn = out.to_track_quat("Z", "Y")
            if turn.dot(self.item.rotation_quaternion) < 0.0:
                turn = -turn
            self.item.location = place
            self.item.rotation_quaternion = turn
            self.item.keyframe_insert("location", frame=frame)
            self.item.keyframe_insert("rotation_quaternion", frame=frame)
        # Disabled while it travels: a fast collider would cost the solver useless substeps.
        for frame, enabled in ((start, False), (keys[0][0], True), (keys[-1][0], False)):
            self.item.tactile_clay.collider_enabled = enabled
            self.item.keyframe_insert("tactile_clay.collider_enabled", frame=frame)
        return self.item

    def _key(self, frame: int, place: Vector, out: Vector) -> None:
        self._keys.append((frame, place, out))


def mirrored(spot: Spot) -> Spot:
    """The same spot on the other side of the face."""
    flip = Matrix.Diagonal((-1.0, 1.0, 1.0))
    return flip @ spot[0], flip @ spot[1]


def bow_shape(
    radius: float, thickness: float, half_angle: float
) -> tuple[NDArray[np.float64], list[Sequence[int]]]:
    """A bent rod with round ends, which prints a smile: vertices [m] and faces.

    It lies in the xy plane, open toward +y; the side that touches the clay first is at height 0.

    Args:
        radius: Radius of the bend [m].
        thickness: Radius of the rod [m].
        half_angle: Angle from its middle to an end [radians].
    """
    around, along = 12, 24
    # The ends are hemispheres, with a ring for each of these angles.
    cap = np.linspace(0.0, 0.5 * np.pi, 5)[1:-1]
    stations = [(-half_angle, -np.sin(c), np.cos(c)) for c in cap[::-1]]
    stations += [(turn, 0.0, 1.0) for turn in np.linspace(-half_angle, half_angle, along)]
    stations += [(half_angle, np.sin(c), np.cos(c)) for c in cap]
    angles = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)

    def ring(turn: float, beyond: float, width: float) -> NDArray[np.float64]:
        out = np.array([np.sin(turn), -np.cos(turn), 0.0])
        forward = np.array([np.cos(turn), np.sin(turn), 0.0])
        middle = radius * out + thickness * beyond * forward + (0.0, radius, thickness)
        spokes = np.outer(np.cos(angles), out) + np.outer(np.sin(angles), (0.0, 0.0, 1.0))
        return middle + thickness * width * spokes

    rings = [ring(*station) for station in stations]
    last = around * (len(rings) - 1)
    faces: list[Sequence[int]] = [range(around), range(last + around - 1, last - 1, -1)]
    faces += [
        (start + n, start + around + n, start + around + (n + 1) % around, start + (n + 1) % around)
        for start in range(0, last, around)
        for n in range(around)
    ]
    return np.concatenate(rings), faces


def _add_handle(tool: bpy.types.Object, start: float, radius: float) -> None:
    """Add a wooden handle along a tool's axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    profile = (
        (0.75, -0.004),
        (0.95, 0.004),
        (1.0, 0.3 * _HANDLE),
        (0.85, _HANDLE),
        (0.4, 1.04 * _HANDLE),
    )
    rings = [
        np.stack(
            [r * radius * np.cos(angles), r * radius * np.sin(angles), np.full(24, start + z)],
            axis=1,
        )
        for r, z in profile
    ]
    faces: list[Sequence[int]] = [range(23, -1, -1), range(24 * (len(rings) - 1), 24 * len(rings))]
    faces += [
        (24 * ring + n, 24 * ring + (n + 1) % 24, 24 * ring + 24 + (n + 1) % 24, 24 * ring + 24 + n)
        for ring in range(len(rings) - 1)
        for n in range(24)
    ]
    handle = mesh_object(f"{tool.name}, handle", np.concatenate(rings), faces)
    handle.data.shade_smooth()
    handle.data.materials.append(plain_material(handle.name, (0.42, 0.22, 0.09), 0.4))
    handle.parent = tool
