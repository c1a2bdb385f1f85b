# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a take: the motion of hands and tools in a live session, step by step.

A take's folder holds ``take.json``, the header; ``take_start.npz``, the clay at the start;
``take_tools_000.npz`` and so on, the tools moved with the mouse; and ``take_000000.npz`` and so on,
the steps, a few seconds in each file. Files are written atomically, so an interrupted take can be
read up to its last file. The frames of the clay are in the same folder, in the format of a bake.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..storage.atomic_files import (
    CacheDamagedError,
    CacheMissingError,
    read_arrays,
    write_arrays,
    write_atomically,
)
from .data import Layout, Steps, Take, TakeHeader, ToolShape, without_undone

FORMAT_VERSION = 1
_STEPS = re.compile(r"take_(\d{6})\.npz")
_TOOLS = re.compile(r"take_tools_(\d{3,})\.npz")


def write_header(directory: Path, header: TakeHeader) -> None:
    """Write ``take.json``.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    table = {"take_format": FORMAT_VERSION, **asdict(header)}
    text = json.dumps(table, indent=2) + "\n"
    write_atomically(directory / "take.json", lambda file: file.write(text.encode()))


def read_header(directory: Path) -> TakeHeader:
    """Read ``take.json``.

    Raises:
        CacheMissingError: There is no take in the folder.
        CacheDamagedError: The file is not valid, or its version is not supported.
    """
    path = directory / "take.json"
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        version = table.pop("take_format")
        if version != FORMAT_VERSION:
            raise CacheDamagedError(
                f"{path} has format {version!r}; this version of the add-on reads format "
                f"{FORMAT_VERSION}. Update the add-on."
            )
        clay = tuple((str(name), int(count), float(s)) for name, count, s in table.pop("clay"))
        return TakeHeader(clay=clay, **table)
    except (FileNotFoundError, NotADirectoryError):
        raise CacheMissingError(f"there is no take in {directory}") from None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise CacheDamagedError(f"{path} is damaged ({error})") from error


def is_take(directory: Path) -> bool:
    """Whether a folder holds a take."""
    return (directory / "take.json").is_file()


def write_start(
    directory: Path, start: Mapping[str, tuple[NDArray[np.float32], NDArray[np.float32]]]
) -> None:
    """Write the clay at the start of a take, in the order of its header.

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
    """Write steps to the file with the given number.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    text = json.dumps({"layout": asdict(steps.layout), "events": steps.events})
    arrays: dict[str, NDArray[Any]] = {name: getattr(steps, name) for name in Steps.ARRAYS}
    # The last row of a pose is always 0, 0, 0, 1.
    for name in ("objects", "bones", "tool_poses"):
        arrays[name] = arrays[name][..., :3, :]
    arrays["said"] = np.frombuffer(text.encode(), np.uint8)
    write_arrays(directory / f"take_{number:06d}.npz", arrays)


def read_take(directory: Path, *, unwritten: Mapping[int, Steps] | None = None) -> Take:
    """Read a take, even an interrupted one.

    Args:
        directory: Folder of the take.
        unwritten: Steps not yet in the folder, by file number.

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
        raise CacheDamagedError("take_start.npz belongs to another take") from error
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


def _numbered(directory: Path, pattern: re.Pattern[str]) -> list[Path]:
    """Files of a take in order, up to the first missing number."""
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
        metadata = json.loads(arrays.pop("said").tobytes())
        table = metadata["layout"]
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
        return Steps(layout, **arrays, events=metadata["events"])
    except (ValueError, KeyError, TypeError) as error:
        raise CacheDamagedError(f"{path.name} is damaged ({error})") from error
