# SPDX-License-Identifier: GPL-3.0-or-later
"""TOML files of presets: their names, and reading them with errors that name the file."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any


def preset_names(folder: Path) -> list[str]:
    """Names of the presets in a folder, sorted."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def preset_path(folder: Path, name: str, kind: str) -> Path:
    """The file of a preset.

    Args:
        folder: Where the presets of this kind are.
        name: One of `preset_names`; anything else, such as a path, is refused.
        kind: What the presets describe, for the error message.

    Raises:
        ValueError: There is no such preset; the message lists those that exist.
    """
    names = preset_names(folder)
    if name not in names:
        raise ValueError(f"There is no {kind} preset {name!r}. There are: {', '.join(names)}.")
    return folder / f"{name}.toml"


def read_tables(path: Path, required: str) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: The file.
        required: Name of a table that it must have.

    Raises:
        ValueError: The file is not valid TOML or lacks the table.
        OSError: The file cannot be read.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path.name} is not a valid TOML file: {error}.") from error
    if not isinstance(tables.get(required), dict):
        raise ValueError(f"{path.name} has no [{required}] table.")
    return tables


def check_keys(path: Path, keys: Iterable[str], known: Collection[str]) -> None:
    """Refuse unknown keys.

    Args:
        path: The file that the keys are from.
        keys: The keys of one of its tables.
        known: The keys that the table may have.

    Raises:
        ValueError: A key is unknown; the message lists the known ones.
    """
    for key in keys:
        if key not in known:
            raise ValueError(
                f"{path.name}: unknown key {key!r}. Known keys: {', '.join(sorted(known))}."
            )
