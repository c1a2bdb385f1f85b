# SPDX-License-Identifier: GPL-3.0-or-later
"""Edits of a take while it is baked again: clay that is added, removed and painted.

All frames of a bake have the same number of particles. The clay of a film therefore contains from
the first frame the particles that will be added. Until then they are absent, as removed particles
are: they are not simulated, and are shown at exactly the position of a present particle.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, get_args

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.take.data import TakeEdit
from ..core.take.frames import nearest
from ..core.tools.edits import Edit, EditKind, apply_edit
from ..model.clay_points import ABSENT
from ..model.clay_scene import clay_colors, read_points

FIRST_COLOR = "clay_first_color"
"""Attribute that stores the initial colors; the color attribute has those at the last frame."""
_SPARE_RATIO = 1.25
"""Ratio of spare particles to those that the edits would add in empty space: the actual number
depends on how the clay moves in between."""
_TIME_TOLERANCE = 1e-4
"""Times closer than this are the same [frames]."""


def unknown_edit(edits: Sequence[TakeEdit]) -> TakeEdit | None:
    """The first edit of a kind that this add-on does not support; None if it supports all."""
    return next((edit for edit in edits if edit.kind not in get_args(EditKind)), None)


def edits_to_text(edits: Sequence[TakeEdit], *, start: int, rate: float) -> str:
    """Serialize edits, with their times in frames, for a property; empty if there are none.

    Args:
        edits: Edits of a take.
        start: First frame of the take.
        rate: Frame rate [1/s].
    """
    tables = [{"frame": start + edit.time * rate, **asdict(edit)} for edit in edits]
    return json.dumps(tables) if tables else ""


def edits_from_text(text: str) -> list[TakeEdit]:
    """Parse the text of `edits_to_text`."""
    tables = json.loads(text) if text else []
    return [TakeEdit(t["time"], t["kind"], t["parameters"]) for t in tables]


def spare_particle_count(edits: Sequence[TakeEdit], spacing: float) -> int:
    """Number of particles to reserve for edits, at a particle spacing [m]."""
    points, colors = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)
    for each in edits:
        if each.kind == "add":
            added = apply_edit(_edit(each), points, colors, spacing)
            points, colors = added.positions, added.colors
    return int(np.ceil(_SPARE_RATIO * len(points)))


def prepare_for_edits(item: bpy.types.Object, absent_count: int) -> None:
    """Mark the last points of a clay object as absent, and store its initial colors."""
    absent = np.zeros(len(item.data.points), bool)
    absent[len(absent) - absent_count :] = True
    layer = item.data.attributes.new(ABSENT, "BOOLEAN", "POINT")
    layer.data.foreach_set("value", absent)
    colors = item.data.attributes.new(FIRST_COLOR, "FLOAT_COLOR", "POINT")
    colors.data.foreach_set("color", clay_colors(item).ravel())


class EditedClay:
    """Presence and colors of the particles in a bake with edits.

    Args:
        text: Result of `edits_to_text`.
        clay: The clay objects.
        rest: Initial world positions of each object [Blender units], shape [N, 3].
        scale: Length of a Blender unit [m].
    """

    def __init__(
        self,
        text: str,
        clay: Sequence[bpy.types.Object],
        rest: Sequence[NDArray[np.float32]],
        scale: float,
    ) -> None:
        frames = [float(table["frame"]) for table in json.loads(text)]
        edits = [_edit(edit) for edit in edits_from_text(text)]
        self._edits = list(zip(frames, edits, strict=True))
        self._spacing = float(clay[0].tactile_clay.spacing) * scale
        self._scale = scale
        self._object = np.repeat(np.arange(len(clay)), [len(each) for each in rest])
        self._rest = np.concatenate(rest).astype(np.float32)
        self._first_colors = np.concatenate([_first_colors(item) for item in clay])
        self._first_present = ~np.concatenate([_absent(item) for item in clay])
        self.lost = 0
        """Number of particles that could not be added because all spare ones were in use."""
        self.begin()

    def begin(self) -> None:
        """Go back to the initial state."""
        self.present = self._first_present.copy()
        self.colors = self._first_colors.copy()
        self._positions = self._rest.copy()
        self._find_shown()

    def bodies(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """World positions [Blender units] and colors of the present particles of each object."""
        count = int(self._object.max()) + 1
        masks = [self.present & (self._object == index) for index in range(count)]
        return [(self._positions[mask], self.colors[mask]) for mask in masks]

    def expand(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Expand rows of the present particles to all; absent ones get those of another."""
        expanded = np.empty((len(self.present), values.shape[1]), np.float32)
        expanded[self.present] = values
        return expanded[self._shown]

    def is_due(self, after: float, until: float) -> bool:
        """Whether there are edits after one time and until another [frames]."""
        return bool(self._due(after, until))

    def _due(self, after: float, until: float) -> list[Edit]:
        start, end = after + _TIME_TOLERANCE, until + _TIME_TOLERANCE
        return [edit for frame, edit in self._edits if start < frame <= end]

    def apply(self, after: float, until: float, positions: NDArray[np.float32]) -> bool:
        """Apply the edits in a time interval.

        Args:
            after: Start of the interval, excluded [frames].
            until: End of the interval, included [frames].
            positions: World positions of the present particles [Blender units], shape [P, 3].

        Returns:
            Whether particles were added or removed, so that the solver must be rebuilt.
        """
        self._positions[self.present] = positions
        changed = False
        for edit in self._due(after, until):
            for index in self._edited_objects(edit):
                changed |= self._apply(edit, np.flatnonzero(self._object == index))
        if changed:
            self._find_shown()
        return changed

    def _edited_objects(self, edit: Edit) -> Sequence[int]:
        """Indices of the objects that an edit applies to."""
        if edit.kind != "add":
            return range(int(self._object.max()) + 1)
        # As in a live session, new clay is added to the nearest object.
        present = np.flatnonzero(self.present)
        offsets = self._positions[present] * self._scale - np.float32(np.array(edit.center))
        return [int(self._object[present[np.argmin((offsets**2).sum(1))]])]

    def _apply(self, edit: Edit, rows: NDArray[np.int64]) -> bool:
        present = rows[self.present[rows]]
        positions = self._positions[present] * np.float32(self._scale)
        result = apply_edit(edit, positions, self.colors[present], self._spacing)
        if not len(result.positions):
            # As in a live session, an object keeps its last particles.
            return False
        old = result.kept >= 0
        kept, new = present[result.kept[old]], np.flatnonzero(~old)
        free = rows[~self.present[rows]]
        self.lost += max(len(new) - len(free), 0)
        new, added = new[: len(free)], free[: len(new)]
        self.present[present] = False
        self.present[kept] = self.present[added] = True
        self.colors[kept] = result.colors[old]
        self.colors[added] = result.colors[new]
        self._positions[added] = result.positions[new] / np.float32(self._scale)
        return bool(len(added) or len(kept) < len(present))

    def _find_shown(self) -> None:
        """Find the present particle at whose position each particle is shown."""
        present = np.flatnonzero(self.present)
        self._shown = np.arange(len(self.present))
        absent = np.flatnonzero(~self.present)
        if len(absent):
            indices = nearest(self._positions[present], self._positions[absent])
            self._shown[absent] = present[indices]

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """The current state as arrays."""
        return {
            "scene_edit_present": self.present.copy(),
            "scene_edit_positions": self._positions.copy(),
            "scene_edit_colors": self.colors.copy(),
            "scene_edit_place": self._shown.copy(),
            "scene_edit_lost": np.array(self.lost),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> bool:
        """Restore a state from `snapshot`, and return whether other particles are present.

        Raises:
            KeyError: An array is missing.
            ValueError: The state belongs to other clay.
        """
        present = state["scene_edit_present"].astype(bool)
        if present.shape != self.present.shape:
            raise ValueError("The snapshot belongs to other clay.")
        changed = not np.array_equal(present, self.present)
        self.present = present
        self._positions = state["scene_edit_positions"].copy()
        self.colors = state["scene_edit_colors"].copy()
        self._shown = state["scene_edit_place"].copy()
        self.lost = int(state["scene_edit_lost"])
        return changed


def _edit(edit: TakeEdit) -> Edit:
    values = dict(edit.parameters)
    for name in ("center", "color"):
        if name in values:
            values[name] = tuple(values[name])
    return Edit(kind=edit.kind, **values)  # type: ignore[arg-type]


def _first_colors(item: bpy.types.Object) -> NDArray[np.float32]:
    colors = read_points(item, FIRST_COLOR, 4)
    return clay_colors(item) if colors is None else colors


def _absent(item: bpy.types.Object) -> NDArray[np.bool_]:
    absent = np.zeros(len(item.data.points), bool)
    layer = item.data.attributes.get(ABSENT)
    if layer is not None:
        layer.data.foreach_get("value", absent)
    return absent
