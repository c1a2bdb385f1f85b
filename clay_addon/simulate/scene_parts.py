# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection and checks of the objects that take part in a simulation."""

from __future__ import annotations

import bpy

from ..base.mesh_geometry import SWITCHED_OFF, is_switched_off
from ..hands.hand import hand_objects
from ..hands.reading import HandError
from ..model.clay_scene import SimulationError
from ..model.collider import TAKE_TOOL
from .hand_motion import MovingHand

LIVE_HOLD_STIFFNESS = 600.0
"""Stiffness with which a live hand holds its pose against the clay [N/m]: nothing supports the hand
in the air, so a fingertip pressed with 6 N is held back by a centimeter."""


def read_hands(context: bpy.types.Context, *, live: bool) -> list[MovingHand]:
    """Read the hands that take part in a simulation.

    Raises:
        SimulationError: A hand is not bound, or has changed since it was bound.
    """
    gives_way = live or context.scene.tactile_clay.hands_give_way
    hold_stiffness = LIVE_HOLD_STIFFNESS if gives_way else None
    hands = hand_objects(context.scene)
    if hands and live:
        hands = participants(hands, context.evaluated_depsgraph_get(), live=True)
    try:
        return [MovingHand(context, item, hold_stiffness=hold_stiffness) for item in hands]
    except HandError as error:
        raise SimulationError(str(error)) from error


def participants(
    objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, *, live: bool
) -> list[bpy.types.Object]:
    """Select the objects that take part in a simulation.

    A live session leaves out objects that are switched off, and the tools of earlier takes. A bake
    does not: it later refuses objects that are switched off, since that may be a mistake.
    """
    return [
        item
        for item in objects
        if not (live and (is_switched_off(item, depsgraph) or TAKE_TOOL in item))
    ]


def check_clay(clay: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> None:
    """Refuse clay that Blender does not evaluate, or that shares its point cloud.

    Raises:
        SimulationError: An object is unusable; the message says what to do.
    """
    users: dict[bpy.types.ID, bpy.types.Object] = {}
    for item in clay:
        if is_switched_off(item, depsgraph):
            raise SimulationError(f"{item.name!r} {SWITCHED_OFF}")
        other = users.setdefault(item.data, item)
        if other != item:
            raise SimulationError(
                f"{item.name!r} is a linked duplicate of {other.name!r}, so both would show the "
                "same particles. Make it a separate copy (Object > Relations > Make Single "
                "User > Object & Data)."
            )


def common_spacing(clay: list[bpy.types.Object], scale: float) -> float:
    """The particle spacing shared by all clay [Blender units].

    Args:
        clay: The clay objects.
        scale: Length of a Blender unit [m], for the message.

    Raises:
        SimulationError: The spacings differ, or an object has none.
    """
    spacings = {item.name: item.tactile_clay.spacing for item in clay}
    first = next(iter(spacings.values()))
    for name, spacing in spacings.items():
        if not spacing > 0:
            raise SimulationError(f"{name!r} has no spacing. Make the clay again.")
        if abs(spacing - first) > 1e-6 * first:
            sizes = ", ".join(f"{n!r} {s * scale * 1e3:.3g} mm" for n, s in spacings.items())
            raise SimulationError(
                f"All clay in a scene needs the same spacing, but the spacings are {sizes}. Make "
                "the clay again where the spacing differs."
            )
    return first
