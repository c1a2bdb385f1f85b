# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports a recording of hands as keyframes on their armatures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Quaternion, Vector

from ..base.keyed_channels import Channel, write_channels
from ..core.tracking import TrackingError
from ..core.tracking.protocol.joints import SIDES
from ..core.tracking.recording.recording import Entry
from ..core.tracking.recording.resample import resampled_hands
from .armature import CONTACT_PROPERTY, local_poses, placed, read_target

_MAX_FRAMES = 200_000
"""A recording with more frames than this is assumed to contain a wrong time."""


class Imported(NamedTuple):
    """The result of an import."""

    first: int
    """First frame with keyframes."""
    last: int
    """Last frame with keyframes."""
    sides: tuple[str, ...]
    """Sides of the hands that were animated."""


def import_recording(
    scene: bpy.types.Scene,
    entries: Sequence[Entry],
    armatures: Mapping[str, bpy.types.Object],
    *,
    start: int,
    name: str = "Hands",
    origin: bpy.types.Object | None = None,
) -> Imported:
    """Animate armatures from a recording, with a keyframe on every frame for every bone.

    Each armature gets a new action; its previous one stays in the file. After the end of the
    recording the hand keeps its last pose and touches nothing.

    Args:
        scene: Provides the frame rate and the unit scale.
        entries: The recording.
        armatures: The armature of each side; a side without one is skipped.
        start: The frame at which the recording starts.
        name: Name of the actions; the side is appended.
        origin: Object at the tracker's position and rotation; the world origin if None.

    Raises:
        TrackingError: The recording is too long, no recorded hand has an armature, or an armature
            cannot follow a hand.
    """
    rate = scene.render.fps / scene.render.fps_base
    count = int(entries[-1].time * 1e-9 * rate) + 2
    if count > _MAX_FRAMES:
        raise TrackingError(f"The recording would take {count:,} frames; its times are wrong.")
    times = [round(frame / rate * 1e9) for frame in range(count)]
    hands = resampled_hands(entries, times)
    seen = [side for side in SIDES if any(hands[side])]
    sides = tuple(side for side in seen if side in armatures)
    if not sides:
        raise TrackingError(
            f"The recording contains the {' and the '.join(seen)} hand. Choose an armature for it "
            "in the Tracking panel."
            if seen
            else "The recording contains no usable hand."
        )
    targets = {side: read_target(armatures[side], side, scene) for side in sides}
    for side in sides:
        # The last frame is after the end of the recording, where no hand touches anything.
        contacts = [hand.contact if hand else 0.0 for hand in hands[side]]
        contacts[-1] = 0.0
        first = next(hand for hand in hands[side] if hand is not None)
        poses = []
        for hand in hands[side]:
            matrices = placed(targets[side], hand or first, origin, scene)
            poses.append(local_poses(armatures[side], matrices))
        _write_keys(armatures[side], poses, contacts, start, f"{name} {side}")
    return Imported(start, start + count - 1, sides)


def _write_keys(
    armature: bpy.types.Object,
    poses: Sequence[Mapping[str, object]],
    contacts: Sequence[float],
    start: int,
    name: str,
) -> None:
    armature[CONTACT_PROPERTY] = 0.0
    frames = np.arange(start, start + len(poses))
    values = np.asarray(contacts, np.float32)
    channels = [Channel(f'["{CONTACT_PROPERTY}"]', 0, frames, values)]
    for bone_name in poses[0]:
        bone = armature.pose.bones[bone_name]
        bone.rotation_mode = "QUATERNION"
        locations, rotations = _decomposed([pose[bone_name] for pose in poses])
        for property_name, array in (
            ("location", locations),
            ("rotation_quaternion", rotations),
        ):
            path = f"{bone.path_from_id()}.{property_name}"
            channels += [
                Channel(path, index, frames, column, group=bone_name)
                for index, column in enumerate(array.T)
            ]
    write_channels(armature, name, channels)


def _decomposed(poses: Sequence[object]) -> tuple[np.ndarray, np.ndarray]:
    """Locations, shape [N, 3], and quaternions (w, x, y, z), shape [N, 4], without sign flips."""
    locations = np.empty((len(poses), 3), np.float32)
    rotations = np.empty((len(poses), 4), np.float32)
    previous: Quaternion | None = None
    for index, pose in enumerate(poses):
        location: Vector
        location, rotation, _ = pose.decompose()  # type: ignore[attr-defined]
        if previous is not None:
            rotation.make_compatible(previous)
        locations[index], rotations[index] = location, rotation
        previous = rotation
    return locations, rotations
