# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading what a simulation needs from a Blender scene: clay, colliders, settings, device."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ...solver.scene.material import Material
from ...solver.scene.settings import Settings
from ..base.mesh_geometry import is_absent, transform
from ..base.preferences import device_choice, missing_parts
from .material_properties import read_material


class SimulationError(TactileClayError):
    """A scene cannot be simulated; the message says why and what to do."""


def clay_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The clay of a scene, sorted by name: the order of particles in the solver and the cache."""
    found = [
        item
        for item in scene.objects
        if item.type == "POINTCLOUD" and item.tactile_clay.role == "CLAY"
    ]
    return sorted(found, key=lambda item: item.name)


def collider_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The colliders of a scene, sorted by name."""
    found = [item for item in scene.objects if item.tactile_clay.role == "COLLIDER"]
    return sorted(found, key=lambda item: item.name)


def is_enabled(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether the clay feels a collider at the current frame: it is there, and touches clay."""
    if is_absent(item, depsgraph):
        return False
    return bool(item.evaluated_get(depsgraph).tactile_clay.collider_enabled)


def frames_per_second(scene: bpy.types.Scene) -> float:
    """Frame rate [1/s]."""
    return scene.render.fps / scene.render.fps_base


def read_points(
    item: bpy.types.Object, attribute: str, width: int = 3
) -> NDArray[np.float32] | None:
    """A vector or color attribute of a point cloud, shape [N, width]; None if it has none."""
    layer = item.data.attributes.get(attribute)
    key = {"FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}.get(layer.data_type) if layer else None
    if layer is None or key is None:
        return None
    values = np.empty((len(layer.data), width), np.float32)
    layer.data.foreach_get(key, values.ravel())
    return values


def clay_colors(item: bpy.types.Object) -> NDArray[np.float32]:
    """Colors of a clay object's points, linear RGBA, shape [N, 4]; white if it has none."""
    colors = read_points(item, "Color", 4)
    return np.ones((len(item.data.points), 4), np.float32) if colors is None else colors


def clay_positions(item: bpy.types.Object, attribute: str = "rest_position") -> NDArray[np.float32]:
    """World positions of a clay object's points [Blender units], shape [N, 3].

    Args:
        item: A clay object.
        attribute: ``rest_position``, which a bake starts from, or ``position``, as displayed.

    Raises:
        SimulationError: The attribute is missing, empty or not finite, or the object's transform
            is not finite or scales it.
    """
    local = read_points(item, attribute)
    if local is None:
        raise SimulationError(
            f"{item.name!r} has lost its attribute {attribute}, so its starting shape is "
            "unknown. Undo, or make the clay again."
        )
    if not len(local):
        raise SimulationError(f"{item.name!r} has no points. Make the clay again.")
    bad = int((~np.isfinite(local).all(1)).sum())
    if bad:
        raise SimulationError(f"{item.name!r} has {bad} points that are not finite. Delete them.")
    matrix = np.array(item.matrix_world, np.float64)
    if not np.isfinite(matrix).all():
        raise SimulationError(
            f"The transform of {item.name!r} is not finite. Look for a bad value in its "
            "animation or drivers."
        )
    if not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-4):
        raise SimulationError(
            f"{item.name!r} is scaled, which changes the spacing of its particles. Clear the "
            "scale (Alt+S), scale the meshes it was made from, and make the clay again."
        )
    return transform(matrix, local).astype(np.float32)


def material_of(item: bpy.types.Object) -> Material:
    """The material of a clay object."""
    return read_material(item.tactile_clay)


def solver_settings(scene: bpy.types.Scene) -> Settings:
    """The solver's settings for a scene."""
    substeps = scene.tactile_clay.substeps
    return Settings(substeps=substeps) if substeps else Settings()


def solver_device(context: bpy.types.Context, device: str | None = None) -> str:
    """The device to compute on: ``cpu`` or ``cuda:0``.

    Args:
        context: The context that has the preferences.
        device: ``auto``, ``cpu`` or ``cuda:0``; by default the preferences decide.

    Raises:
        SimulationError: Warp is missing, or there is no such device.
    """
    for sentence in missing_parts():
        raise SimulationError(sentence)
    import warp

    device = device or device_choice(context)
    cards = warp.get_cuda_device_count()
    if device == "auto":
        return "cuda:0" if cards else "cpu"
    if device != "cpu" and not (device.startswith("cuda:") and device[5:].isdigit()):
        raise SimulationError(f"There is no device {device!r}. Choose auto, cpu or cuda:0.")
    if device != "cpu" and int(device[5:]) >= cards:
        raise SimulationError(
            f"This machine has no CUDA device {device!r}. Choose auto or cpu in the preferences."
        )
    return device


def checked_material(item: bpy.types.Object) -> Material:
    """The material of a clay object.

    Raises:
        SimulationError: A value is out of range; the message names the object.
    """
    try:
        return material_of(item)
    except ValueError as error:
        raise SimulationError(f"{item.name!r}: {error}") from error
