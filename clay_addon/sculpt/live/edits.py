# SPDX-License-Identifier: GPL-3.0-or-later
"""Applying edits to the clay objects of a scene: adding, removing and painting clay."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.mesh_geometry import local_from_world, transform
from ...base.units import meters_per_unit
from ...core.tools.edits import Edit, apply_edit
from ...model.clay_points import replace_points, write_colors
from ...model.clay_scene import clay_colors, read_points


def edit_clay(
    context: bpy.types.Context, clay: Sequence[bpy.types.Object], edits: Sequence[Edit]
) -> bool:
    """Apply edits to clay objects.

    New clay is added to the nearest object. An edit that would remove an object's last particle is
    ignored for that object, so that it does not vanish under a brush.

    Args:
        context: The context with the objects.
        clay: Clay objects.
        edits: Edits to apply in order.

    Returns:
        Whether anything has changed.
    """
    scale = meters_per_unit(context.scene)
    shapes = [_read(item, scale) for item in clay]
    changed = [False] * len(clay)
    for edit in edits:
        chosen = range(len(clay))
        if edit.kind == "add":
            distances = [_distance(points, edit) for points, _ in shapes]
            chosen = range(int(np.argmin(distances)), int(np.argmin(distances)) + 1)
        for index in chosen:
            points, colors = shapes[index]
            spacing = clay[index].tactile_clay.spacing * scale
            result = apply_edit(edit, points, colors, spacing)
            if not len(result.positions):
                continue
            if result.moves_particles or not np.array_equal(result.colors, colors):
                shapes[index] = result.positions, result.colors
                changed[index] = True
    for item, (points, colors), touched in zip(clay, shapes, changed, strict=True):
        if not touched:
            continue
        if len(points) == len(item.data.points):
            write_colors(item, colors)
        else:
            local = transform(local_from_world(item), points / np.float32(scale))
            replace_points(context, item, local, colors)
    return any(changed)


def _read(item: bpy.types.Object, scale: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """World positions [m] and colors of a clay object's points."""
    local = read_points(item, "position")
    assert local is not None
    world = transform(np.array(item.matrix_world), local) * scale
    return world.astype(np.float32), clay_colors(item)


def _distance(points: NDArray[np.float32], edit: Edit) -> float:
    return float(
        np.linalg.norm(points - np.array(edit.center, np.float32), axis=1).min(initial=np.inf)
    )
