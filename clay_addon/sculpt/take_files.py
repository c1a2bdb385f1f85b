# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes on disk: what hands and tools did in a live session, step by step.

A take's folder holds ``take.json``, which says what it is of; ``take_start.npz``, the clay it began
with; ``take_tools_000.npz`` and so on, the tools that were in the mouse; and ``take_000000.npz``
and so on, the steps, some seconds in each file. Every file is there whole or not at all, so a take
that was cut short can be read up to its last file. The clay's frames stand beside them as a bake's.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cache_files import (
    CacheDamagedError,
    CacheMissingError,
    read_arrays,
    write_arrays,
    write_whole,
)

FORMAT_VERSION = 1
_STEPS = re.compile(r"take_(\d{6})\.npz")
_TOOLS = re.compile(r"take_tools_(\d{3,})\.npz")


@dataclass(frozen=True)
class TakeHeader:
    """What a take is of, as its ``take.json`` keeps it."""

    frame_start: int
    """The frame at which it begins."""
    frames_per_second: float
    """Of the timeline that it was recorded for [1/s]."""
    unit_scale: float
    """Length of a Blender unit [m]."""
    clay: tuple[tuple[str, int, float], ...]
    """Name, number of particles and their spacing [Blender units] of each clay object."""
    seconds: float | None = None
    """How long it is [s]; None while it is recorded, or where it was cut short."""


@dataclass(frozen=True)
class Layout:
    """What the rows of some steps are of."""

    objects: tuple[str, ...] = ()
    """Objects whose own transform is followed."""
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
    """That of each bone, of all armatures after each other, shape [K, B, 4, 4]."""
    contacts: NDArray[np.float32]
    """How much of each armature's hand touches the clay, 0 to 1, shape [K, A]."""
    enabled: NDArray[np.bool_]
    """Which colliders the clay feels, shape [K, C]."""
    tool_poses: NDArray[np.float32]
    """World from each tool's own coordinates [m], shape [K, T, 4, 4]."""
    tool_enabled: NDArray[np.bool_]
    """Which tools the clay feels, shape [K, T]."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """Edits and rewinds, each with the number of steps of the whole take before it (``after``)."""

    ARRAYS = ("times", "objects", "bones", "contacts", "enabled", "tool_poses", "tool_enabled")

    def kept(self, rows: NDArray[np.bool_] | slice) -> Steps:
        """Only some of the steps, without events."""
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
class Edit:
    """A change to the particles themselves, such as added clay."""

    time: float
    """When, in the take [s]."""
    kind: str
    """What was done."""
    parameters: Mapping[str, Any]
    """How, whatever the spacing of the clay: lengths in Blender units, world space."""


@dataclass(frozen=True)
class Take:
    """A take as it was read; what was taken back by Undo is not in it."""

    header: TakeHeader
    steps: tuple[Steps, ...]
    """All steps in the order of their times."""
    edits: tuple[Edit, ...]
    """In the order they were made."""
    tools: Mapping[int, ToolShape]
    """By number."""
    start: Mapping[str, tuple[NDArray[np.float32], NDArray[np.float32]]]
    """World positions [Blender units], [N, 3], and colours, [N, 4], of each clay object."""

    @property
    def seconds(self) -> float:
        """How long it is [s]."""
        last = float(self.steps[-1].times[-1])
        return last if self.header.seconds is None else self.header.seconds


def frame_count(seconds: float, rate: float) -> int:
    """Frames from the first of a take to its last, where it has come to its end."""
    return max(1, math.ceil(seconds * rate - 1e-6))


def write_header(directory: Path, header: TakeHeader) -> None:
    """Write ``take.json``.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    table = {"take_format": FORMAT_VERSION, **asdict(header)}
    text = json.dumps(table, indent=2) + "\n"
    write_whole(directory / "take.json", lambda file: file.write(text.encode()))


def read_header(directory: Path) -> TakeHeader:
    """Read ``take.json``.

    Raises:
        CacheMissingError: There is no take in the folder.
        CacheDamagedError: The file cannot be understood.
    """
    path = directory / "take.json"
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        version = table.pop("take_format")
        if version != FORMAT_VERSION:
            raise CacheDamagedError(
                f"{path} is of version {version!r}; this add-on reads version {FORMAT_VERSION}. "
                "Update the add-on."
            )
        clay = tuple((str(name), int(count), float(s)) for name, count, s in table.pop("clay"))
        return TakeHeader(clay=clay, **table)
    except (FileNotFoundError, NotADirectoryError):
        raise CacheMissingError(f"there is no take in {directory}") from None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise CacheDamagedError(f"{path} cannot be understood ({error})") from error


def is_take(directory: Path) -> bool:
    """Whether a folder holds a take."""
    return (directory / "take.json").is_file()


def write_start(
    directory: Path, start: Mapping[str, tuple[NDArray[np.float32], NDArray[np.float32]]]
) -> None:
    """Write the clay that a take begins with, in the order of its header.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for number, (positions, colors) in enumerate(start.values()):
        arrays[f"positions_{number}"], arrays[f"colors_{number}"] = positions, colors
    write_arrays(directory / "take_start.npz", arrays)


def write_tool(directory: Path, number: int, tool: ToolShape) -> None:
    """Write the shape of a tool.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    arrays: dict[str, NDArray[Any]] = {
        "vertices": tool.vertices,
        "faces": tool.faces,
        "friction": np.array(tool.friction),
    }
    write_arrays(directory / f"take_tools_{number:03d}.npz", arrays)


def write_steps(directory: Path, number: int, steps: Steps) -> None:
    """Write some steps as the file of a number.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    text = json.dumps({"layout": asdict(steps.layout), "events": steps.events})
    arrays: dict[str, NDArray[Any]] = {name: getattr(steps, name) for name in Steps.ARRAYS}
    # Of a pose's last row nothing is to be known.
    for name in ("objects", "bones", "tool_poses"):
        arrays[name] = arrays[name][..., :3, :]
    arrays["said"] = np.frombuffer(text.encode(), np.uint8)
    write_arrays(directory / f"take_{number:06d}.npz", arrays)


def read_take(directory: Path, *, unwritten: Mapping[int, Steps] | None = None) -> Take:
    """Read a take, also one that was cut short.

    Args:
        directory: Its folder.
        unwritten: Steps that are not in the folder, by the number of their file.

    Raises:
        CacheMissingError: There is no take in the folder, or nothing was recorded.
        CacheDamagedError: A file is truncated or altered; the message names it.
    """
    header = read_header(directory)
    arrays = read_arrays(directory / "take_start.npz")
    try:
        start = {
            name: (arrays[f"positions_{number}"], arrays[f"colors_{number}"])
            for number, (name, _, _) in enumerate(header.clay)
        }
    except KeyError as error:
        raise CacheDamagedError("take_start.npz is of another take") from error
    parts = [_read_steps(path) for path in _numbered(directory, _STEPS)]
    while unwritten and len(parts) in unwritten:
        parts.append(unwritten[len(parts)])
    if not parts:
        raise CacheMissingError(f"nothing was recorded in {directory}")
    steps, edits = without_undone(parts)
    if not steps:
        raise CacheMissingError(f"nothing was recorded in {directory}")
    tools = {}
    for number, path in enumerate(_numbered(directory, _TOOLS)):
        shape = read_arrays(path, ("vertices", "faces", "friction"))
        tools[number] = ToolShape(shape["vertices"], shape["faces"], float(shape["friction"]))
    return Take(header, tuple(steps), tuple(edits), tools, start)


def without_undone(parts: Sequence[Steps]) -> tuple[list[Steps], list[Edit]]:
    """Leave out the steps and edits that were taken back.

    Args:
        parts: All steps in the order they were recorded.
    """
    kept: list[Steps] = []
    edits: list[Edit] = []
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
                edits.append(Edit(event["time"], event["kind"], event["parameters"]))
                continue
            # Rewound: what lies later is gone.
            del edits[event["edits"] :]
            kept = [
                each.kept(each.times <= event["time"] + 1e-9)
                for each in kept
                if each.times[0] <= event["time"] + 1e-9
            ]
        count += len(part.times)
    return kept, edits


def _numbered(directory: Path, pattern: re.Pattern[str]) -> list[Path]:
    """Files of a take in the order of their numbers, up to the first that is missing."""
    found = {}
    for path in directory.iterdir():
        if match := pattern.fullmatch(path.name):
            found[int(match[1])] = path
    paths: list[Path] = []
    while len(paths) in found:
        paths.append(found[len(paths)])
    return paths


def _read_steps(path: Path) -> Steps:
    arrays = read_arrays(path, (*Steps.ARRAYS, "said"))
    try:
        said = json.loads(arrays.pop("said").tobytes())
        table = said["layout"]
        layout = Layout(
            objects=tuple(table["objects"]),
            armatures=tuple((name, tuple(bones)) for name, bones in table["armatures"]),
            colliders=tuple(table["colliders"]),
            tools=tuple(table["tools"]),
        )
        for name in ("objects", "bones", "tool_poses"):
            rows = arrays[name]
            whole = np.zeros((*rows.shape[:2], 4, 4), np.float32)
            whole[..., :3, :] = rows
            whole[..., 3, 3] = 1.0
            arrays[name] = whole
        return Steps(layout, **arrays, events=said["events"])
    except (ValueError, KeyError, TypeError) as error:
        raise CacheDamagedError(f"{path.name} cannot be understood ({error})") from error
