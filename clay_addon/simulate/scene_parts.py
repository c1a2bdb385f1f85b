# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection and checks of the objects that take part in a simulation."""

from __future__ import annotations

import bpy

from ..base.mesh_geometry import SWITCHED_OFF, is_absent, is_switched_off
from ..hands.hand import hand_objects
from ..hands.reading import HandError
from ..model.clay_scene import SimulationError
from ..model.properties import frame_range
from .colliders import first_shown
from .hand_motion import MovingHand

LIVE_HOLD_STIFFNESS = 600.0
"""Stiffness with which a live hand holds its pose against the clay [N/m]: nothing supports the hand
in the air, so a fingertip pressed with 6 N is held back by a centimeter."""


def read_hands(context: bpy.types.Context, *, live: bool) -> list[MovingHand]:
    """The hands that take part in a simulation: those that are on in the viewport.

    In a bake, one that is keyed off is there, and out of contact until its keys switch it on.

    Raises:
        SimulationError: A hand is not bound, or has changed since it was bound.
    """
    gives_way = live or context.scene.tactile_clay.hands_give_way
    hold_stiffness = LIVE_HOLD_STIFFNESS if gives_way else None
    hands = hand_objects(context.scene)
    depsgraph = context.evaluated_depsgraph_get()
    off = is_absent if live else is_switched_off
    hands = [item for item in hands if not off(item, depsgraph)]
    scene = context.scene
    found = []
    for item in hands:
        start = scene.frame_current
        if is_absent(item, context.evaluated_depsgraph_get()):
            # Blender deforms it only while it is on.
            _, end = frame_range(scene)
            if first_shown(item, scene, max(end, scene.frame_end)) is None:
                scene.frame_set(start)
                continue
        try:
            found.append(MovingHand(context, item, hold_stiffness=hold_stiffness))
        except HandError as error:
            raise SimulationError(str(error)) from error
        finally:
            if scene.frame_current != start:
                scene.frame_set(start)
    return found


def clay_there(
    objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, *, live: bool
) -> list[bpy.types.Object]:
    """The clay that takes part in a simulation.

    A live session leaves out what is off in the viewport. A bake is of all clay of a scene, so it
    refuses that (see `check_clay`).
    """
    return [item for item in objects if not (live and is_absent(item, depsgraph))]


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
