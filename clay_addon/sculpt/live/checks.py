# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks whether the clay of a scene can be sculpted now."""

from __future__ import annotations

import bpy

from ....solver.core.errors import TactileClayError
from ...base.activity import BusyError, clay_activity
from ...base.preferences import missing_parts
from ...deliver.object import delivered_object
from ...model.clay_scene import clay_objects
from ...playback.packed import is_packed


class SculptError(TactileClayError):
    """A session cannot start or continue; the message says why and what to do."""


def check_free(scene: bpy.types.Scene) -> None:
    """Check that nothing prevents the clay from being sculpted.

    Raises:
        SculptError: Something is missing from the installation, or the clay is in use, delivered,
            being rendered, packed or linked.
    """
    for sentence in missing_parts():
        raise SculptError(sentence)
    try:
        clay_activity.check_free()
    except BusyError as error:
        raise SculptError(str(error)) from error
    if delivered_object(scene) is not None:
        raise SculptError(
            "The delivered files are shown in place of the clay. Press Show Clay Again first (Clay "
            "> Delivery)."
        )
    if bpy.app.is_job_running("RENDER"):
        raise SculptError("Blender is rendering. Wait until it has finished.")
    for item in clay_objects(scene):
        if is_packed(item):
            raise SculptError(
                f"{item.name!r} plays frames packed in the .blend. Unpack them first (Clay > Bake)."
            )
        if item.library is not None or item.data.library is not None:
            raise SculptError(f"{item.name!r} is linked from another file. Make it local first.")
