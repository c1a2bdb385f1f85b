# SPDX-License-Identifier: GPL-3.0-or-later
"""Data of a take: motion of hands and tools, edits of the clay, and the clay at its start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TakeHeader:
    """Properties of a take, as stored in its ``take.json``."""

    frame_start: int
    """Frame at which the take begins."""
    frames_per_second: float
    """Frame rate of the scene when the take was recorded [1/s]."""
    unit_scale: float
    """Length of a Blender unit [m]."""
    clay: tuple[tuple[str, int, float], ...]
    """Name, particle count and particle spacing [Blender units] of each clay object."""
    seconds: float | None = None
    """Length [s]; None during the recording and for an interrupted take."""


@dataclass(frozen=True)
class Layout:
    """The objects, bones, colliders and tools in the columns of `Steps`."""

    objects: tuple[str, ...] = ()
    """Objects whose transform is recorded."""
    armatures: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Armature objects and their bones."""
    colliders: tuple[str, ...] = ()
    """Objects whose contact with the clay can be switched on and off."""
    tools: tuple[int, ...] = ()
    """Numbers of the tools moved with the mouse."""


@dataclass
class Steps:
    """Consecutive steps of a take, one row each."""

    layout: Layout
    times: NDArray[np.float64]
    """Simulated time at the end of each step [s], shape [K]; 0 for the first step of a take."""
    objects: NDArray[np.float32]
    """``matrix_basis`` of each object, shape [K, O, 4, 4]."""
    bones: NDArray[np.float32]
    """``matrix_basis`` of each bone, in armature order, shape [K, B, 4, 4]."""
    contacts: NDArray[np.float32]
    """Contact property of each armature, 0 to 1, shape [K, A]."""
    enabled: NDArray[np.bool_]
    """Whether each collider touches the clay, shape [K, C]."""
    tool_poses: NDArray[np.float32]
    """Transform of each tool from local to world space [m], shape [K, T, 4, 4]."""
    tool_enabled: NDArray[np.bool_]
    """Whether each tool touches the clay, shape [K, T]."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """Edits and rewinds; ``after`` is the number of steps of the whole take before each."""

    ARRAYS = ("times", "objects", "bones", "contacts", "enabled", "tool_poses", "tool_enabled")

    def select(self, rows: NDArray[np.bool_] | slice) -> Steps:
        """Select some of the steps, without events."""
        return Steps(self.layout, *(getattr(self, name)[rows] for name in self.ARRAYS))


@dataclass(frozen=True)
class ToolShape:
    """A tool moved with the mouse."""

    vertices: NDArray[np.float64]
    """Vertices in local coordinates [m], shape [V, 3]."""
    faces: NDArray[np.int32]
    """Triangles, shape [F, 3]."""
    friction: float
    """Coulomb friction coefficient."""


@dataclass(frozen=True)
class TakeEdit:
    """A change to the particles other than by simulation, such as added clay."""

    time: float
    """Time in the take [s]."""
    kind: str
    """Kind of edit, an `EditKind`."""
    parameters: Mapping[str, Any]
    """Parameters, independent of the particle spacing: lengths in meters, world space."""


@dataclass(frozen=True)
class Take:
    """A take as read from disk, without the steps and edits that were undone."""

    header: TakeHeader
    steps: tuple[Steps, ...]
    """All steps, ordered by time."""
    edits: tuple[TakeEdit, ...]
    """Edits in the order they were made."""
    tools: Mapping[int, ToolShape]
    """Tools by number."""
    start: Mapping[str, tuple[NDArray[np.float32], NDArray[np.float32]]]
    """Initial world positions [Blender units], [N, 3], and colors, [N, 4], by clay object."""

    @property
    def seconds(self) -> float:
        """Length of the take [s]."""
        last = float(self.steps[-1].times[-1])
        return last if self.header.seconds is None else self.header.seconds


def frame_count(seconds: float, rate: float) -> int:
    """Number of frames after the first one of a take; the last shows the clay at its end."""
    return max(1, math.ceil(seconds * rate - 1e-6))


def without_undone(parts: Sequence[Steps]) -> tuple[list[Steps], list[TakeEdit]]:
    """Leave out the steps and edits that were undone.

    Args:
        parts: All steps, in the order they were recorded.
    """
    kept: list[Steps] = []
    edits: list[TakeEdit] = []
    count = 0
    for part in parts:
        first = 0
        for event in [*part.events, None]:
            last = len(part.times) if event is None else max(event["after"] - count, first)
            if last > first:
                kept.append(part.select(slice(first, last)))
                first = last
            if event is None:
                continue
            if event["event"] == "edit":
                edits.append(TakeEdit(event["time"], event["kind"], event["parameters"]))
                continue
            # A rewind drops everything later.
            del edits[event["edits"] :]
            kept = [
                each.select(each.times <= event["time"] + 1e-9)
                for each in kept
                if each.times[0] <= event["time"] + 1e-9
            ]
        count += len(part.times)
    return kept, edits
