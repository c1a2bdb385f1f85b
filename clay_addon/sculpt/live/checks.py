# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the clay of a scene is free to be sculpted."""

from __future__ import annotations

import bpy

from ...bake import operators as bake_operators
from ...base.preferences import missing_parts
from ...deliver import operators as delivery_operators
from ...deliver.object import delivered_object
from ...model.clay_scene import clay_objects
from ...playback.pack import is_packed


class SculptError(Exception):
    """A session cannot start or continue; the message says why and what to do."""


def check_free(scene: bpy.types.Scene) -> None:
    """Refuse if something else uses the clay.

    Raises:
        SculptError: The clay is being baked or rendered, or is packed or linked.
    """
    for sentence in missing_parts():
        raise SculptError(sentence)
    if bake_operators.running is not None or delivery_operators.running is not None:
        raise SculptError("A bake is running. Press Esc to stop it first.")
    if delivered_object(scene) is not None:
        raise SculptError(
            "What was delivered is shown in place of the clay. Press Show Clay Again first (Clay > "
            "Delivery)."
        )
    if bpy.app.is_job_running("RENDER"):
        raise SculptError("Blender is rendering. Sculpt when it has done.")
    for item in clay_objects(scene):
        if is_packed(item):
            raise SculptError(
                f"{item.name!r} plays frames packed in the .blend. Unpack them first (Clay > Bake)."
            )
        if item.library is not None or item.data.library is not None:
            raise SculptError(f"{item.name!r} is linked from another file. Make it local first.")
