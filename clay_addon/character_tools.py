# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools of the character scene: colliders that keyframes press into the clay and draw along."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .collider import make_collider
from .kindergarten_parts import Vec3, mesh_object, plain_material
from .tool_presets import load_tool_preset

_AWAY = 0.03
"""How far off the clay a tool waits [m]."""
_PARKED = Vector((0.45, -0.05, 0.30))
"""Where tools of her left side wait, out of the picture [m]; the others opposite."""
_TRAVEL = 16
"""Frames from there to the clay."""
_HANDLE = 0.10
"""Length of a tool's handle, which does not touch the clay [m]."""

Spot = tuple[Vector, Vector]
"""A place on the clay [m], and the direction out of the clay there."""


class ModellingTool:
    """A tool from the presets, to be keyed stroke by stroke.

    Args:
        context: Its collection takes the tool.
        name: Of the object.
        preset: One of `tool_presets.tool_preset_names`.
        radius: How large it is [m]; see the presets.
        spacing: Of the clay [m].
        color: Linear RGB.
        handle: Radius of its handle [m]; 0 for none.
    """

    def __init__(
        self,
        context: bpy.types.Context,
        name: str,
        preset: str,
        *,
        radius: float,
        spacing: float,
        color: Vec3,
        handle: float = 0.0,
    ) -> None:
        self._keys: list[tuple[int, Vector, Vector]] = []
        kind = load_tool_preset(preset)
        vertices = kind.fitted(radius, spacing)
        self.item = mesh_object(name, vertices, kind.faces)
        self.item.data.shade_smooth()
        self.item.data.materials.append(plain_material(name, color, 0.35))
        self.item.rotation_mode = "QUATERNION"
        context.view_layer.update()
        make_collider(self.item, "MESH", kind.friction)
        if handle:
            _add_handle(self.item, float(vertices[:, 2].max()), handle)

    def press(self, spot: Spot, depth: float, frames: tuple[int, int, int, int]) -> None:
        """Press the tool into the clay and take it out the way it came.

        Args:
            spot: Where.
            depth: How deep its tip goes below the place [m]; negative stays above it.
            frames: When it sets out, is all the way in, lets go, and is away again.
        """
        place, out = spot
        away = place + _AWAY * out
        tip = place - depth * out
        for frame, where in zip(frames, (away, tip, tip, away), strict=True):
            self._key(frame, where, out)

    def draw(self, spots: Sequence[Spot], depth: float, start: int, frames_each: int) -> None:
        """Draw the tool through the clay along a line, and take it out.

        Args:
            spots: The line.
            depth: How deep its tip goes below it [m].
            start: Frame at which it sets out.
            frames_each: Between two spots.
        """
        (first, out), (last, last_out) = spots[0], spots[-1]
        self._key(start, first + _AWAY * out, out)
        frame = start + 2 * frames_each
        for place, way in spots:
            self._key(frame, place - depth * way, way)
            frame += frames_each
        self._key(frame + frames_each, last + _AWAY * last_out, last_out)

    def write(self) -> bpy.types.Object:
        """Key what the tool was told to do, and that it waits out of the picture before and after.

        Returns:
            The tool's object.
        """
        keys = sorted(self._keys, key=lambda key: key[0])
        side = 1.0 if keys[0][1].x > -1e-3 else -1.0
        parked = Vector((side * _PARKED.x, _PARKED.y, _PARKED.z))
        start, end = keys[0][0] - _TRAVEL, keys[-1][0] + _TRAVEL
        for frame, place, out in ((start, parked, keys[0][2]), *keys, (end, parked, keys[-1][2])):
            turn = out.to_track_quat("Z", "Y")
            if turn.dot(self.item.rotation_quaternion) < 0.0:
                turn = -turn
            self.item.location = place
            self.item.rotation_quaternion = turn
            self.item.keyframe_insert("location", frame=frame)
            self.item.keyframe_insert("rotation_quaternion", frame=frame)
        # On the way it is fast, and would cost the solver substeps for nothing.
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


def _add_handle(tool: bpy.types.Object, start: float, radius: float) -> None:
    """Put a wooden handle on a tool, along its axis."""
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
