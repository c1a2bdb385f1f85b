# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording of hands as keyframes on their armatures."""

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

_LONGEST = 200_000
"""Frames; a recording longer than that holds a wrong time."""


class Imported(NamedTuple):
    """What an import did."""

    first: int
    """First frame with keys."""
    last: int
    """Last frame with keys."""
    sides: tuple[str, ...]
    """The hands that got keys."""


def import_recording(
    scene: bpy.types.Scene,
    entries: Sequence[Entry],
    armatures: Mapping[str, bpy.types.Object],
    *,
    start: int,
    name: str = "Hands",
    origin: bpy.types.Object | None = None,
) -> Imported:
    """Put a recording on armatures, a key on every frame for every bone.

    Each armature gets a new action; the one it had stays in the file. Where the recording ends the
    hand stays, and touches nothing.

    Args:
        scene: Its frame rate and unit scale count.
        entries: The recording.
        armatures: The armature of each side; a side without one is left out.
        start: The frame at which the recording starts.
        name: Of the actions.
        origin: The object that stands where the tracker did.

    Raises:
        TrackingError: There is no armature for a hand of the recording, or it cannot follow one.
    """
    rate = scene.render.fps / scene.render.fps_base
    count = int(entries[-1].time * 1e-9 * rate) + 2
    if count > _LONGEST:
        raise TrackingError(f"The recording would take {count:,} frames; its times are wrong.")
    times = [round(number / rate * 1e9) for number in range(count)]
    hands = resampled_hands(entries, times)
    seen = [side for side in SIDES if any(hands[side])]
    sides = tuple(side for side in seen if side in armatures)
    if not sides:
        raise TrackingError(
            f"The recording is of the {' and the '.join(seen) or 'no'} hand. Choose an armature "
            "for it in the Tracking panel."
        )
    targets = {side: read_target(armatures[side], side, scene) for side in sides}
    for side in sides:
        # The last frame is past the end, where no hand touches anything.
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
    touching = Channel(f'["{CONTACT_PROPERTY}"]', 0, frames, np.asarray(contacts, np.float32))
    channels = [touching]
    for bone_name in poses[0]:
        bone = armature.pose.bones[bone_name]
        bone.rotation_mode = "QUATERNION"
        locations, turns = _channels([pose[bone_name] for pose in poses])
        for path, array in (("location", locations), ("rotation_quaternion", turns)):
            whole = f"{bone.path_from_id()}.{path}"
            channels += [
                Channel(whole, index, frames, column, group=bone_name)
                for index, column in enumerate(array.T)
            ]
    write_channels(armature, name, channels)


def _channels(poses: Sequence[object]) -> tuple[np.ndarray, np.ndarray]:
    """Locations [N, 3] and quaternions (w, x, y, z) [N, 4] of transforms, without jumps of sign."""
    locations = np.empty((len(poses), 3), np.float32)
    turns = np.empty((len(poses), 4), np.float32)
    before: Quaternion | None = None
    for number, pose in enumerate(poses):
        location: Vector
        location, turn, _ = pose.decompose()  # type: ignore[attr-defined]
        if before is not None:
            turn.make_compatible(before)
        locations[number], turns[number] = location, turn
        before = turn
    return locations, turns
