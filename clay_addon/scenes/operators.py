# SPDX-License-Identifier: GPL-3.0-or-later
"""The menu Add > Clay: ready-made clay and complete scenes."""

from __future__ import annotations

from collections.abc import Callable
from math import radians
from typing import Any

import bpy

from ..base.preferences import missing_parts
from ..clay.meshes import ClayError
from ..hands.add_hand import AddHandError
from ..hands.reading import HandError
from ..model.collider import ColliderError
from ..model.material_presets import SCENE, operator_items
from .block import add_block
from .slump import add_slump_test
from .stage import look_at, scene_preset

_INCLINE = scene_preset("incline")
_FAILURES = (AddHandError, ClayError, ColliderError, HandError)


def add_scene(
    context: bpy.types.Context, name: str, build: Callable[[bpy.types.Context], Any]
) -> Any:
    """Create a new scene, switch to it and fill it; on failure, restore the previous state.

    Args:
        context: Its window switches to the new scene.
        name: Name of the scene.
        build: Fills the scene of the context it is given.

    Returns:
        The result of `build`.

    Raises:
        ClayError: Something that the solver needs is missing.
    """
    for sentence in missing_parts():
        raise ClayError(sentence)
    window = context.window
    before = window.scene
    scene = bpy.data.scenes.new(name)
    window.scene = scene
    try:
        with context.temp_override(
            window=window, scene=scene, view_layer=scene.view_layers[0], collection=scene.collection
        ):
            built = build(bpy.context)
    except BaseException:
        window.scene = before
        for item in list(scene.objects):
            bpy.data.objects.remove(item)
        bpy.data.scenes.remove(scene)
        raise
    # Scenes in one file must not share a cache.
    folder = bpy.path.clean_name(scene.name).lower()
    scene.tactile_clay.cache_directory = f"//clay_cache_{folder}"
    return built


class _Add:
    """Common parts of the operators."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available in Object Mode."""
        return context.mode == "OBJECT" and context.window is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the clay or scene, or report why it cannot be added."""
        try:
            self.add(context)
        except _FAILURES as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        return {"FINISHED"}

    def add(self, context: bpy.types.Context) -> None:
        """Add the operator's clay or scene."""
        raise NotImplementedError


class CLAY_OT_block_add(_Add, bpy.types.Operator):  # noqa: N801
    """Add a block of clay on the 3D cursor, with a table under it"""

    bl_idname = "clay.block_add"
    bl_label = "Add Clay Block"

    size: bpy.props.FloatProperty(
        name="Size",
        description="Edge length of the block; 0 makes one of about 4,000 particles",
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        precision=3,
        options={"SKIP_SAVE"},
    )
    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between particles; 0 uses that of the scene's clay",
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
    table: bpy.props.BoolProperty(
        name="Table",
        description="Add a table under it if the scene has no collider",
        default=True,
    )

    def add(self, context: bpy.types.Context) -> None:
        """Add the block."""
        clay = add_block(
            context,
            size=self.size,
            spacing=self.spacing,
            preset=None if self.material_preset == SCENE else self.material_preset,
            table=self.table,
        )
        # So that the Adjust Last Operation panel shows the actual values.
        self.spacing = clay.tactile_clay.spacing
        self.size = self.size or max(clay.dimensions)
        look_at(context, clay.location, self.size)
        self.report({"INFO"}, f"{clay.name}: {len(clay.data.points):,} particles")


class CLAY_OT_slump_test_add(_Add, bpy.types.Operator):  # noqa: N801
    """Add a cylinder of soft clay on the 3D cursor; a ring shows how far it should sink"""

    bl_idname = "clay.slump_test_add"
    bl_label = "Add Slump Test"

    height: bpy.props.FloatProperty(
        name="Height",
        description="Height and width of the cylinder; 0 makes one of about 3,000 particles",
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        precision=3,
        options={"SKIP_SAVE"},
    )
    yield_stress: bpy.props.FloatProperty(
        name="Yield Stress (Pa)",
        description="Shear stress at which the clay yields; 0 makes it sink by about a half",
        min=0.0,
        soft_max=2000.0,
        options={"SKIP_SAVE"},
    )
    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between particles; 0 uses that of the scene's clay",
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        precision=4,
        options={"SKIP_SAVE"},
    )
    table: bpy.props.BoolProperty(
        name="Table",
        description="Add a table under it if the scene has no collider",
        default=True,
    )

    def add(self, context: bpy.types.Context) -> None:
        """Add the cylinder and the ring."""
        test = add_slump_test(
            context,
            height=self.height,
            yield_stress=self.yield_stress,
            spacing=self.spacing,
            table=self.table,
        )
        self.spacing = test.clay.tactile_clay.spacing
        self.yield_stress = test.clay.tactile_clay.yield_stress
        self.height = self.height or test.clay.dimensions[2]
        look_at(context, test.clay.location, 2.5 * self.height)
        self.report(
            {"INFO"},
            f"The top should sink to the ring, by {test.expected:.2f} of its height. Bake 1 second",
        )


class CLAY_OT_incline_scene_add(_Add, bpy.types.Operator):  # noqa: N801
    """Add a scene in which four blocks with different materials fall on a slope"""

    bl_idname = "clay.incline_scene_add"
    bl_label = "Add Incline"

    angle: bpy.props.FloatProperty(
        name="Angle",
        description="Angle of the slope",
        subtype="ANGLE",
        default=radians(_INCLINE["angle"]),
        min=0.0,
        max=radians(60.0),
    )
    friction: bpy.props.FloatProperty(
        name="Friction",
        description="Coulomb friction coefficient of slope and clay",
        default=_INCLINE["friction"],
        min=0.0,
        soft_max=1.0,
    )
    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between particles",
        subtype="DISTANCE",
        unit="LENGTH",
        default=_INCLINE["spacing"],
        min=0.002,
        max=0.01,
        precision=4,
    )

    def add(self, context: bpy.types.Context) -> None:
        """Add the scene."""
        from . import incline as incline_scene

        add_scene(
            context,
            "Incline",
            lambda within: incline_scene.build(
                within, angle=self.angle, friction=self.friction, spacing=self.spacing
            ),
        )


class CLAY_OT_kindergarten_scene_add(_Add, bpy.types.Operator):  # noqa: N801
    """Add a scene with colored blocks of clay on a table, and two hands that work them"""

    bl_idname = "clay.kindergarten_scene_add"
    bl_label = "Add Kindergarten"

    def add(self, context: bpy.types.Context) -> None:
        """Add the scene."""
        from . import kindergarten

        add_scene(context, "Kindergarten", kindergarten.build)


class CLAY_OT_character_scene_add(_Add, bpy.types.Operator):  # noqa: N801
    """Add a scene in which tools model a bust of Suzanne"""

    bl_idname = "clay.character_scene_add"
    bl_label = "Add Character"

    def add(self, context: bpy.types.Context) -> None:
        """Add the scene."""
        from . import character as character_scene

        add_scene(context, "Character", character_scene.build)


class CLAY_OT_wheel_scene_add(_Add, bpy.types.Operator):  # noqa: N801
    """Add a scene with clay on a potter's wheel, and two hands that throw a pot"""

    bl_idname = "clay.wheel_scene_add"
    bl_label = "Add Potter's Wheel"

    def add(self, context: bpy.types.Context) -> None:
        """Add the scene."""
        from . import wheel as wheel_scene

        add_scene(context, "Potter's wheel", wheel_scene.build)


class CLAY_MT_add(bpy.types.Menu):  # noqa: N801
    """Add > Clay"""

    bl_idname = "CLAY_MT_add"
    bl_label = "Clay"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the items that are added to the current scene, then the complete scenes."""
        layout = self.layout
        layout.operator_context = "INVOKE_REGION_WIN"
        layout.operator("clay.block_add", text="Block", icon="MESH_CUBE")
        layout.operator("clay.slump_test_add", text="Slump Test", icon="MESH_CYLINDER")
        layout.operator("clay.hand_add", text="Hand", icon="VIEW_PAN")
        layout.operator_menu_enum("clay.array_add", "preset", text="Ultrasound Array")
        layout.separator()
        layout.operator("clay.kindergarten_scene_add", text="Kindergarten", icon="SCENE_DATA")
        layout.operator("clay.wheel_scene_add", text="Potter's Wheel", icon="SCENE_DATA")
        layout.operator("clay.character_scene_add", text="Character", icon="SCENE_DATA")
        layout.operator("clay.incline_scene_add", text="Incline", icon="SCENE_DATA")


def _draw_in_add_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.menu("CLAY_MT_add", icon="META_BALL")


_CLASSES = (
    CLAY_OT_block_add,
    CLAY_OT_slump_test_add,
    CLAY_OT_incline_scene_add,
    CLAY_OT_kindergarten_scene_add,
    CLAY_OT_character_scene_add,
    CLAY_OT_wheel_scene_add,
    CLAY_MT_add,
)


def register() -> None:
    """Register the operators, and add their menu to the Add menu."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.VIEW3D_MT_add.append(_draw_in_add_menu)


def unregister() -> None:
    """Unregister the operators and the menu."""
    bpy.types.VIEW3D_MT_add.remove(_draw_in_add_menu)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
