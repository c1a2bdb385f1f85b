# SPDX-License-Identifier: GPL-3.0-or-later
"""Edits of a take while it is baked again: clay that is added, taken away and painted.

A bake has as many particles from its first frame to its last. So a film's clay has those that will
be added from the beginning. They are absent: the solver does not know them, and they are shown at
the very place of another particle, as those are that were taken away.
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
"""Attribute that keeps the colors at the beginning; those that are shown are of the end."""
_SPARE = 1.25
"""Room for added particles, over what the edits would add one after another where no clay is: what
they add depends on how the clay moves meanwhile."""
_AT_ONCE = 1e-4
"""Moments closer than this are the same [frames]."""


def unknown_edit(edits: Sequence[TakeEdit]) -> TakeEdit | None:
    """The first edit of a kind that this add-on does not know; None where it knows all."""
    return next((edit for edit in edits if edit.kind not in get_args(EditKind)), None)


def edits_text(edits: Sequence[TakeEdit], *, start: int, rate: float) -> str:
    """Edits as a property keeps them, with their moments in frames; empty where there are none.

    Args:
        edits: Of a take.
        start: Frame at which the take begins.
        rate: Frames in a second [1/s].
    """
    tables = [{"frame": start + edit.time * rate, **asdict(edit)} for edit in edits]
    return json.dumps(tables) if tables else ""


def edits_of_text(text: str) -> list[TakeEdit]:
    """The edits that `edits_text` wrote."""
    tables = json.loads(text) if text else []
    return [TakeEdit(t["time"], t["kind"], t["parameters"]) for t in tables]


def room_for(edits: Sequence[TakeEdit], spacing: float) -> int:
    """How many particles are to be kept ready for edits, at a spacing [m]."""
    points, colors = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)
    for each in edits:
        if each.kind == "add":
            added = apply_edit(_edit(each), points, colors, spacing)
            points, colors = added.positions, added.colors
    return int(np.ceil(_SPARE * len(points)))


def prepare_for_edits(item: bpy.types.Object, absent_count: int) -> None:
    """Say that the last points of a clay object are not there yet, and keep its first colors."""
    absent = np.zeros(len(item.data.points), bool)
    absent[len(absent) - absent_count :] = True
    layer = item.data.attributes.new(ABSENT, "BOOLEAN", "POINT")
    layer.data.foreach_set("value", absent)
    colors = item.data.attributes.new(FIRST_COLOR, "FLOAT_COLOR", "POINT")
    colors.data.foreach_set("color", clay_colors(item).ravel())


class EditedClay:
    """The particles of a bake with edits: which are there, and what color they have.

    Args:
        text: What `edits_text` gave.
        clay: The clay objects.
        rest: World positions of each [Blender units], shape [N, 3].
        scale: Length of a Blender unit [m].
    """

    def __init__(
        self,
        text: str,
        clay: Sequence[bpy.types.Object],
        rest: Sequence[NDArray[np.float32]],
        scale: float,
    ) -> None:
        self._edits = [(float(table["frame"]), _edit(TakeEdit(
            table["time"], table["kind"], table["parameters"]
        ))) for table in json.loads(text)]  # fmt: skip
        self._text = text
        self._spacing = float(clay[0].tactile_clay.spacing) * scale
        self._scale = scale
        self._object = np.repeat(np.arange(len(clay)), [len(each) for each in rest])
        self._rest = np.concatenate(rest).astype(np.float32)
        self._first_colors = np.concatenate([_first_colors(item) for item in clay])
        self._first = ~np.concatenate([_absent(item) for item in clay])
        self.lost = 0
        """Particles that were to be added and found no room."""
        self.begin()

    def begin(self) -> None:
        """Go back to the beginning."""
        self.present = self._first.copy()
        self.colors = self._first_colors.copy()
        self._positions = self._rest.copy()
        self._find_places()

    @property
    def text(self) -> str:
        """All that decides what is done, besides the clay."""
        return self._text

    def bodies(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Positions [Blender units] and colors of what is there, for each object."""
        last = int(self._object.max()) + 1
        own = [self.present & (self._object == which) for which in range(last)]
        return [(self._positions[rows], self.colors[rows]) for rows in own]

    def spread(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Rows of all particles from those of the present ones: an absent one has another's."""
        spread = np.empty((len(self.present), values.shape[1]), np.float32)
        spread[self.present] = values
        return spread[self._place]

    def is_due(self, after: float, until: float) -> bool:
        """Whether there are edits between two moments [frames], the second included."""
        return bool(self._due(after, until))

    def _due(self, after: float, until: float) -> list[Edit]:
        return [e for at, e in self._edits if after + _AT_ONCE < at <= until + _AT_ONCE]

    def apply(self, after: float, until: float, positions: NDArray[np.float32]) -> bool:
        """Carry out the edits between two moments [frames].

        Args:
            after: The first moment, itself excluded.
            until: The second moment, included.
            positions: Positions of the present particles [Blender units], shape [P, 3].

        Returns:
            Whether particles came or went, so that the solver has to be built again.
        """
        self._positions[self.present] = positions
        changed = False
        for edit in self._due(after, until):
            for which in self._objects_of(edit):
                changed |= self._apply(edit, np.flatnonzero(self._object == which))
        if changed:
            self._find_places()
        return changed

    def _objects_of(self, edit: Edit) -> Sequence[int]:
        """As live, new clay goes to the object that is nearest."""
        if edit.kind != "add":
            return range(int(self._object.max()) + 1)
        there = np.flatnonzero(self.present)
        away = self._positions[there] * self._scale - np.float32(np.array(edit.center))
        return [int(self._object[there[np.argmin((away**2).sum(1))]])]

    def _apply(self, edit: Edit, rows: NDArray[np.int64]) -> bool:
        there = rows[self.present[rows]]
        places = self._positions[there] * np.float32(self._scale)
        result = apply_edit(edit, places, self.colors[there], self._spacing)
        if not len(result.positions):
            # An object keeps its last particle, as live.
            return False
        old = result.kept >= 0
        kept, new = there[result.kept[old]], np.flatnonzero(~old)
        free = rows[~self.present[rows]]
        self.lost += max(len(new) - len(free), 0)
        new, taken = new[: len(free)], free[: len(new)]
        self.present[there] = False
        self.present[kept] = self.present[taken] = True
        self.colors[kept] = result.colors[old]
        self.colors[taken] = result.colors[new]
        self._positions[taken] = result.positions[new] / np.float32(self._scale)
        return bool(len(taken) or len(kept) < len(there))

    def _find_places(self) -> None:
        """Find the particle at whose place each one is shown."""
        there = np.flatnonzero(self.present)
        self._place = np.arange(len(self.present))
        absent = np.flatnonzero(~self.present)
        if len(absent):
            near = nearest(self._positions[there], self._positions[absent])
            self._place[absent] = there[near]

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Which particles are there, where and in what color."""
        return {
            "scene_edit_present": self.present.copy(),
            "scene_edit_positions": self._positions.copy(),
            "scene_edit_colors": self.colors.copy(),
            "scene_edit_place": self._place.copy(),
            "scene_edit_lost": np.array(self.lost),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> bool:
        """Take up what `snapshot` gave; whether other particles are there than before.

        Raises:
            KeyError: Something is missing in it.
            ValueError: It is of other clay.
        """
        present = state["scene_edit_present"].astype(bool)
        if present.shape != self.present.shape:
            raise ValueError("The snapshot is of other clay.")
        changed = not np.array_equal(present, self.present)
        self.present = present
        self._positions = state["scene_edit_positions"].copy()
        self.colors = state["scene_edit_colors"].copy()
        self._place = state["scene_edit_place"].copy()
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
