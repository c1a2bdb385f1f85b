# SPDX-License-Identifier: GPL-3.0-or-later
"""Converts the focal points recorded with a bake to keyframed empties, to be seen and rendered.

Each empty follows one focal point from frame to frame. Its scale is the pressure relative to the
maximum of the bake. It is hidden while its focal point does not exist.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..base.keyed_channels import CONSTANT, LINEAR, Channel, write_channels
from ..base.units import from_meters
from ..core.storage.cache import Cache, CacheError
from ..core.storage.foci import FociFrame, read_foci
from ..playback.playback import cache_of

COLLECTION_NAME = "Clay Focal Points"
PRESSURE_PROPERTY = "pressure"
"""Custom property of an empty with the pressure amplitude [Pa]."""
_MARK = "tactile_clay_foci"


class FociError(TactileClayError, ValueError):
    """Focal points cannot be made into empties; the message says why and what to do."""


class FociTracks(NamedTuple):
    """Focal points sorted into tracks, each of one moving point."""

    frames: NDArray[np.int64]
    """Frame numbers, shape [F]."""
    positions: NDArray[np.float32]
    """World positions [Blender units], shape [F, K, 3]; while absent, that of the nearest frame."""
    pressures: NDArray[np.float32]
    """Pressure amplitudes [Pa], 0 while absent, shape [F, K]."""


def follow_foci(frames: Mapping[int, FociFrame], *, reach: float) -> FociTracks:
    """Sort focal points into tracks by joining the nearest pairs of successive frames.

    Args:
        frames: Recorded focal points by frame number.
        reach: Maximum distance that a point moves between two frames [Blender units]; a point
            farther from all others continues an idle track or starts a new one.

    Returns:
        As many tracks as the largest number of focal points in a frame.
    """
    numbers = np.array(sorted(frames), np.int64)
    track_positions: list[dict[int, NDArray[np.float32]]] = []
    track_pressures: list[dict[int, float]] = []
    current: dict[int, NDArray[np.float32]] = {}
    for number in numbers.tolist():
        frame = frames[number]
        points = {k: frame.positions[k] for k in np.flatnonzero(frame.pressures > 0).tolist()}
        pairs = sorted(
            (float(np.linalg.norm(position - before)), point, track)
            for point, position in points.items()
            for track, before in current.items()
        )
        track_of: dict[int, int] = {}
        for distance, point, track in pairs:
            if distance <= reach and point not in track_of and track not in track_of.values():
                track_of[point] = track
        current = {}
        for point, position in points.items():
            if point not in track_of:
                count = len(track_positions)
                idle = (track for track in range(count + 1) if track not in track_of.values())
                track_of[point] = next(idle)
                if track_of[point] == count:
                    track_positions.append({})
                    track_pressures.append({})
            track = track_of[point]
            track_positions[track][number] = current[track] = position
            track_pressures[track][number] = float(frame.pressures[point])
    positions = np.zeros((len(numbers), len(track_positions), 3), np.float32)
    pressures = np.zeros((len(numbers), len(track_positions)), np.float32)
    for track, known in enumerate(track_positions):
        present = np.array(sorted(known))
        nearest = present[np.abs(present[None, :] - numbers[:, None]).argmin(axis=1)]
        positions[:, track] = [known[number] for number in nearest.tolist()]
        pressures[:, track] = [track_pressures[track].get(n, 0.0) for n in numbers.tolist()]
    return FociTracks(numbers, positions, pressures)


def make_empties(scene: bpy.types.Scene, cache: Cache | None = None) -> list[bpy.types.Object]:
    """Make keyframed empties of the focal points recorded with a bake.

    They replace empties made before. They are in a separate collection and work without the add-on.

    Args:
        scene: The scene to add them to.
        cache: The bake; None for the scene's.

    Returns:
        The empties.

    Raises:
        FociError: There is no bake, or it has no focal points.
        CacheError: The cache cannot be read.
    """
    cache = cache or cache_of(scene)
    if cache is None or not cache.exists():
        raise FociError("There is no bake. Bake with an array in the scene first.")
    meta = cache.meta()
    recorded = cache.foci_frames()
    frames = {number: read_foci(cache.directory, number, meta) for number in recorded}
    if not any((frame.pressures > 0).any() for frame in frames.values()):
        raise FociError(
            "The bake recorded no focal points. Add an array in the Touch panel, let a hand press "
            "the clay, and bake again."
        )
    # There are no focal points in frames without a record, or before and after the bake.
    for number in range(recorded[0] - 1, recorded[-1] + 2):
        frames.setdefault(number, _nothing(number))
    sigma = from_meters(scene, max(frame.sigma for frame in frames.values()))
    # A sigma is a wavelength, 8.6 mm at 40 kHz; ten per frame at 24 fps correspond to 2 m/s.
    tracks = follow_foci(frames, reach=10 * sigma)
    collection = _emptied_collection(scene)
    return [
        _make_empty(collection, index, tracks, sigma) for index in range(tracks.pressures.shape[1])
    ]


def _nothing(number: int) -> FociFrame:
    return FociFrame(number, np.zeros((0, 3), np.float32), np.zeros(0, np.float32), 0.0)


def _make_empty(
    collection: bpy.types.Collection, index: int, tracks: FociTracks, sigma: float
) -> bpy.types.Object:
    empty = bpy.data.objects.new(f"Focal Point {index + 1}", None)
    empty.empty_display_type = "SPHERE"
    empty.empty_display_size = sigma
    empty[PRESSURE_PROPERTY] = 0.0
    collection.objects.link(empty)
    pressures = tracks.pressures[:, index]
    absent = pressures <= 0
    scale = np.where(absent, 0.0, pressures / tracks.pressures.max())
    channels = [
        Channel(path, number, tracks.frames, values, kind)
        for path, number, values, kind in (
            *(("location", axis, tracks.positions[:, index, axis], LINEAR) for axis in range(3)),
            *(("scale", axis, scale, LINEAR) for axis in range(3)),
            (f'["{PRESSURE_PROPERTY}"]', 0, pressures, LINEAR),
            ("hide_viewport", 0, absent, CONSTANT),
            ("hide_render", 0, absent, CONSTANT),
        )
    ]
    write_channels(empty, empty.name, channels)
    return empty


def _emptied_collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    for child in scene.collection.children:
        if child.get(_MARK):
            for item in list(child.objects):
                bpy.data.objects.remove(item)
            return child
    collection = bpy.data.collections.new(COLLECTION_NAME)
    collection[_MARK] = True
    scene.collection.children.link(collection)
    return collection


class CLAY_OT_foci_empties(bpy.types.Operator):  # noqa: N801
    """Make keyframed empties of the focal points recorded with the bake"""

    bl_idname = "clay.foci_empties"
    bl_label = "Focal Points to Empties"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make the empties, or report why not."""
        try:
            empties = make_empties(context.scene)
        except (FociError, CacheError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Inserted keyframes for {len(empties)} focal points")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_foci_empties)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_foci_empties)
