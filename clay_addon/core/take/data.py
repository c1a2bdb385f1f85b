# SPDX-License-Identifier: GPL-3.0-or-later
"""What a take holds: steps of hands and tools, edits of the clay, and the clay at its start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TakeHeader:
    """What a take records, as stored in its ``take.json``."""

    frame_start: int
    """The frame at which it begins."""
    frames_per_second: float
    """Frame rate of the timeline that it was recorded for [1/s]."""
    unit_scale: float
    """Length of a Blender unit [m]."""
    clay: tuple[tuple[str, int, float], ...]
    """Name, number of particles and their spacing [Blender units] of each clay object."""
    seconds: float | None = None
    """Its length [s]; None while it is recorded, or if it was cut short."""


@dataclass(frozen=True)
class Layout:
    """What the columns of some steps stand for."""

    objects: tuple[str, ...] = ()
    """Objects whose own transform is recorded."""
    armatures: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Armature objects, and their bones."""
    colliders: tuple[str, ...] = ()
    """Objects that the clay may feel or not."""
    tools: tuple[int, ...] = ()
    """Numbers of the tools in the mouse."""


@dataclass
class Steps:
    """Some steps of a take, one row each."""

    layout: Layout
    times: NDArray[np.float64]
    """Simulated time at the end of each step [s], shape [K]; the first of a take is at 0."""
    objects: NDArray[np.float32]
    """Each object's own transform, ``matrix_basis``, shape [K, O, 4, 4]."""
    bones: NDArray[np.float32]
    """That of each bone, one armature after another, shape [K, B, 4, 4]."""
    contacts: NDArray[np.float32]
    """How much of each armature's hand touches the clay, 0 to 1, shape [K, A]."""
    enabled: NDArray[np.bool_]
    """Whether the clay feels each collider, shape [K, C]."""
    tool_poses: NDArray[np.float32]
    """World from each tool's own coordinates [m], shape [K, T, 4, 4]."""
    tool_enabled: NDArray[np.bool_]
    """Whether the clay feels each tool, shape [K, T]."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """Edits and rewinds, each with the number of steps of the whole take before it (``after``)."""

    ARRAYS = ("times", "objects", "bones", "contacts", "enabled", "tool_poses", "tool_enabled")

    def kept(self, rows: NDArray[np.bool_] | slice) -> Steps:
        """Some of the steps, without events."""
        return Steps(self.layout, *(getattr(self, name)[rows] for name in self.ARRAYS))


@dataclass(frozen=True)
class ToolShape:
    """A tool that was in the mouse."""

    vertices: NDArray[np.float64]
    """In its own coordinates [m], shape [V, 3]."""
    faces: NDArray[np.int32]
    """Triangles, shape [F, 3]."""
    friction: float
    """Coulomb friction coefficient."""


@dataclass(frozen=True)
class TakeEdit:
    """A change to the particles themselves, such as added clay."""

    time: float
    """When, in the take [s]."""
    kind: str
    """What was done."""
    parameters: Mapping[str, Any]
    """How, independent of the spacing of the clay: lengths in meters, world space."""


@dataclass(frozen=True)
class Take:
    """A take as read from disk, without what was undone."""

    header: TakeHeader
    steps: tuple[Steps, ...]
    """All steps in the order of their times."""
    edits: tuple[TakeEdit, ...]
    """Edits in the order they were made."""
    tools: Mapping[int, ToolShape]
    """By number."""
    start: Mapping[str, tuple[NDArray[np.float32], NDArray[np.float32]]]
    """World positions [Blender units], [N, 3], and colors, [N, 4], of each clay object."""

    @property
    def seconds(self) -> float:
        """Its length [s]."""
        last = float(self.steps[-1].times[-1])
        return last if self.header.seconds is None else self.header.seconds


def frame_count(seconds: float, rate: float) -> int:
    """Frames from the first of a take to its last, which shows the clay at its end."""
    return max(1, math.ceil(seconds * rate - 1e-6))


def without_undone(parts: Sequence[Steps]) -> tuple[list[Steps], list[TakeEdit]]:
    """Leave out the steps and edits that were undone.

    Args:
        parts: All steps in the order they were recorded.
    """
    kept: list[Steps] = []
    edits: list[TakeEdit] = []
    count = 0
    for part in parts:
        first = 0
        for event in [*part.events, None]:
            last = len(part.times) if event is None else max(event["after"] - count, first)
            if last > first:
                kept.append(part.kept(slice(first, last)))
                first = last
            if event is None:
                continue
            if event["event"] == "edit":
                edits.append(TakeEdit(event["time"], event["kind"], event["parameters"]))
                continue
            # A rewind: everything later is dropped.
            del edits[event["edits"] :]
            kept = [
                each.kept(each.times <= event["time"] + 1e-9)
                for each in kept
                if each.times[0] <= event["time"] + 1e-9
            ]
        count += len(part.times)
    return kept, edits
