# SPDX-License-Identifier: GPL-3.0-or-later
"""Make Clay: closed meshes become one point cloud of clay particles."""

import math
from collections.abc import Callable, Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.preferences import missing_parts
from ..model.material_presets import SCENE, find_material, operator_items
from ..model.point_cloud import make_point_cloud
from .look import add_look, show_colors
from .meshes import ClayError, check_particle_count, check_place, closed_pieces, fill_pieces

DEFAULT_COLOR = (0.72, 0.36, 0.22, 1.0)
"""Color of a piece that has neither material nor object color: terracotta, linear RGBA."""


def make_clay(
    context: bpy.types.Context,
    objects: Sequence[bpy.types.Object],
    spacing: float | None = None,
    material_preset: str | None = None,
    name: str = "Clay",
    *,
    follow_thin_walls: bool = False,
    on_note: Callable[[str], object] = lambda note: None,
) -> bpy.types.Object:
    """Make one clay object, a point cloud, from closed meshes.

    Modifiers and the objects' transforms are applied. Where pieces overlap, the clay is filled
    only once. The meshes are kept but hidden. If an error is raised, nothing has changed.

    Args:
        context: Its scene and active collection get the clay.
        objects: Mesh objects.
        spacing: Distance between particles [Blender units]; by default the scene's.
        material_preset: Name of a material preset; by default the scene's.
        name: Name of the clay object.
        follow_thin_walls: Whether walls too thin for the spacing get one layer of particles.
        on_note: Called with each note about how a mesh was repaired or filled.

    Raises:
        ClayError: The objects cannot become clay; the message names the object and the reason.
    """
    scene = context.scene
    spacing = scene.tactile_clay.spacing if spacing is None else spacing
    preset = scene.tactile_clay.material_preset if material_preset is None else material_preset
    for sentence in missing_parts():
        raise ClayError(sentence)
    try:
        find_material(preset)
    except ValueError as error:
        raise ClayError(str(error)) from error
    if not (math.isfinite(spacing) and spacing > 0):
        raise ClayError(f"The spacing is {spacing!r}; it must be above 0.")
    if not objects:
        raise ClayError("Nothing is selected. Select one or more closed meshes first.")

    pieces = closed_pieces(objects, context.evaluated_depsgraph_get())
    check_particle_count(pieces, spacing, scene)
    check_place(pieces, spacing)
    points, notes = fill_pieces(pieces, spacing, scene, follow_thin_walls=follow_thin_walls)
    for note in notes:
        on_note(note)
    colors = np.concatenate(
        [
            np.tile(_color_of(item), (len(part), 1))
            for item, part in zip(objects, points, strict=True)
        ]
    ).astype(np.float32)
    return _build(context, objects, np.concatenate(points), colors, spacing, preset, name)


def _color_of(item: bpy.types.Object) -> tuple[float, ...]:
    """Linear RGBA color of a piece: from its material, else from the object, else terracotta."""
    material = item.active_material
    if material is not None:
        if material.node_tree and (bpy.app.version >= (5, 0, 0) or material.use_nodes):
            for node in material.node_tree.nodes:
                if node.type == "BSDF_PRINCIPLED" and not node.inputs["Base Color"].is_linked:
                    return (*tuple(node.inputs["Base Color"].default_value)[:3], 1.0)
        return (*tuple(material.diffuse_color)[:3], 1.0)
    color = tuple(item.color)
    return DEFAULT_COLOR if color == (1.0, 1.0, 1.0, 1.0) else (*color[:3], 1.0)


def _build(
    context: bpy.types.Context,
    sources: Sequence[bpy.types.Object],
    points: NDArray[np.float32],
    colors: NDArray[np.float32],
    spacing: float,
    preset: str,
    name: str,
) -> bpy.types.Object:
    # The origin is at the center of the clay, where users expect the transform gizmo.
    origin = (0.5 * (points.min(0).astype(np.float64) + points.max(0))).astype(np.float32)
    clay = make_point_cloud(context, points - origin, colors, spacing, name)
    clay.location = origin.tolist()
    properties = clay.tactile_clay
    properties.role = "CLAY"
    properties.spacing = spacing
    properties.material_preset = preset
    add_look(clay, spacing=spacing)
    for source in sources:
        source.hide_set(True)
        source.hide_render = True
        properties.sources.add().source = source
        source.select_set(False)
    clay.select_set(True)
    context.view_layer.objects.active = clay
    # Blender crashes if a script changes geometry while the interface draws it during a render.
    context.scene.render.use_lock_interface = True
    context.view_layer.update()
    return clay


class CLAY_OT_make(bpy.types.Operator):  # noqa: N801
    """Turn the selected closed meshes into one clay object; the meshes are kept but hidden"""

    bl_idname = "clay.make"
    bl_label = "Make Clay"
    bl_options = {"REGISTER", "UNDO"}

    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between particles; 0 uses the scene's",
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        precision=4,
        options={"SKIP_SAVE"},
    )
    material_preset: bpy.props.EnumProperty(
        name="Material",
        description="Material of the clay",
        items=operator_items,
        default=0,
        options={"SKIP_SAVE"},
    )

    follow_thin_walls: bpy.props.BoolProperty(
        name="Thin Walls",
        description="Give walls thinner than the spacing one layer of particles",
        default=False,
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make the clay, or report why it cannot be made."""
        window = context.window
        if window and not bpy.app.background:
            window.cursor_modal_set("WAIT")
        try:
            clay = make_clay(
                context,
                list(context.selected_objects),
                self.spacing or None,
                None if self.material_preset == SCENE else self.material_preset,
                follow_thin_walls=self.follow_thin_walls,
                on_note=lambda note: self.report({"WARNING"}, note),
            )
        except ClayError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if window and not bpy.app.background:
                window.cursor_modal_restore()
        show_colors()
        self.report({"INFO"}, f"{clay.name}: {len(clay.data.points):,} particles")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_make)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_make)
