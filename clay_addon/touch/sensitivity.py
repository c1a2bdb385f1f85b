# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows the sensitivity of each part of a hand as a color attribute of its mesh."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils.kdtree import KDTree
from numpy.typing import NDArray

from ..base.mesh_geometry import transform
from ..base.units import to_meters
from ..hands.hand import hand_objects, read_hand_rig
from ..hands.reading import HandError, skinned_hand

LAYER = "Sensitivity"
"""Name of the color attribute."""
_RAMP = np.array(
    [
        (0.02, 0.03, 0.18, 1.0),
        (0.45, 0.08, 0.35, 1.0),
        (0.95, 0.45, 0.05, 1.0),
        (1.0, 0.95, 0.3, 1.0),
    ]
)
"""Linear colors for weights of 0, 1/3, 2/3 and 1."""


def sensitivity_colors(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear RGBA for perceptual weights from 0 to 1, shape [V, 4]."""
    values = np.linspace(0.0, 1.0, len(_RAMP))
    return np.stack([np.interp(weights, values, _RAMP[:, channel]) for channel in range(4)], axis=1)


def paint_sensitivity(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Give the mesh of a bound hand a color attribute of its weights, and make it active.

    Raises:
        HandError: The hand is not bound, or has changed since.
        ValueError: No finger was found by the names of the bones.
    """
    from ...haptics import SkinSensitivity

    weights = SkinSensitivity.of(read_hand_rig(context, item)).vertices
    # The hand in its current pose has the same vertices as the rig, which was bound elsewhere.
    skin = skinned_hand(context, item).vertices
    tree = KDTree(len(skin))
    for index, vertex in enumerate(skin):
        tree.insert(vertex, index)
    tree.balance()
    mesh = item.data
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    local = positions.reshape(-1, 3).astype(float)
    world = to_meters(context.scene, transform(np.array(item.matrix_world), local))
    nearest = np.array([tree.find(vertex)[1] for vertex in world])
    layer = mesh.color_attributes.get(LAYER)
    if layer is not None and (layer.domain, layer.data_type) != ("POINT", "FLOAT_COLOR"):
        mesh.color_attributes.remove(layer)
        layer = None
    layer = layer or mesh.color_attributes.new(LAYER, "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", sensitivity_colors(weights[nearest]).ravel().astype(np.float32))
    mesh.color_attributes.active_color = layer
    mesh.update()


class CLAY_OT_touch_sensitivity(bpy.types.Operator):  # noqa: N801
    """Color the hands by the sensitivity of their skin to touch"""

    bl_idname = "clay.touch_sensitivity"
    bl_label = "Show Sensitivity"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only if there is a hand."""
        return bool(hand_objects(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Color all hands of the scene."""
        painted = 0
        for item in hand_objects(context.scene):
            try:
                paint_sensitivity(context, item)
                painted += 1
            except (HandError, ValueError) as error:
                self.report({"WARNING"}, str(error))
        if not painted:
            return {"CANCELLED"}
        self.report({"INFO"}, f"Viewport Shading > Color > Attribute shows {LAYER!r}.")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_touch_sensitivity)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_touch_sensitivity)
