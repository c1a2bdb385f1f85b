# SPDX-License-Identifier: GPL-3.0-or-later
"""Metadata of a bake, stored in ``meta.json`` in its cache folder."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from .atomic_files import CacheDamagedError
from .clay_layout import ClayLayout, ClaySlice

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Meta:
    """Metadata of a bake: its range, clay objects and inputs."""

    start: int
    """First frame: the rest state."""
    end: int
    """Last frame of the requested range."""
    frames_per_second: float
    """Frames per second of simulated time [1/s]."""
    clay: tuple[ClaySlice, ...]
    """Clay objects, in the order of their particles."""
    settings: Mapping[str, str]
    """Digests of the inputs by subject, to tell which of them changed."""
    owner: str = ""
    """The .blend file and scene that the bake belongs to."""
    version: str = ""
    """Version of the add-on that made the bake."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """Statistics of the last bake, for reports."""

    @property
    def is_take(self) -> bool:
        """Whether the frames were recorded in a live session rather than baked."""
        return "take" in self.settings

    @property
    def layout(self) -> ClayLayout:
        """Ranges of rows in a frame that belong to each object."""
        return ClayLayout(self.clay)

    @property
    def particle_count(self) -> int:
        """Number of particles in every frame."""
        return self.layout.particle_count

    @property
    def digest(self) -> bytes:
        """Digest, 16 bytes, stored in every frame file of this bake."""
        text = json.dumps(
            [FORMAT_VERSION, self.start, self.particle_count, sorted(self.settings.items())]
        )
        return hashlib.blake2b(text.encode(), digest_size=16).digest()

    def to_json(self) -> str:
        """Text of ``meta.json``."""
        table = {"format_version": FORMAT_VERSION, "particle_count": self.particle_count}
        table.update(asdict(self))
        return json.dumps(table, indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Meta:
        """Parse the text of ``meta.json``.

        Raises:
            CacheDamagedError: The text is not in the format of `to_json`.
        """
        try:
            table = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise CacheDamagedError(f"meta.json is not valid JSON ({error})") from error
        if not isinstance(table, dict):
            raise CacheDamagedError("meta.json is not a JSON object")
        version = table.get("format_version")
        if version != FORMAT_VERSION:
            raise CacheDamagedError(
                f"meta.json has format {version!r}; this version of the add-on reads format "
                f"{FORMAT_VERSION}"
            )
        try:
            clay = tuple(
                ClaySlice(_typed(part, "name", str), _typed(part, "count", int))
                for part in _typed(table, "clay", list)
            )
            meta = cls(
                start=_typed(table, "start", int),
                end=_typed(table, "end", int),
                frames_per_second=float(_typed(table, "frames_per_second", float)),
                clay=clay,
                settings={
                    key: _typed(_typed(table, "settings", dict), key, str)
                    for key in _typed(table, "settings", dict)
                },
                owner=_typed(table, "owner", str),
                version=_typed(table, "version", str),
                statistics={
                    key: float(_typed(_typed(table, "statistics", dict), key, float))
                    for key in _typed(table, "statistics", dict)
                },
            )
        except (KeyError, TypeError, OverflowError) as error:
            raise CacheDamagedError(f"meta.json has a missing or invalid entry: {error}") from error
        valid = meta.end >= meta.start and all(part.count > 0 for part in clay)
        if not valid or not math.isfinite(meta.frames_per_second) or meta.frames_per_second <= 0:
            raise CacheDamagedError("meta.json has impossible values")
        if table.get("particle_count") != meta.particle_count:
            raise CacheDamagedError("meta.json has inconsistent particle counts")
        return meta


def _typed(table: Any, key: str, kind: type) -> Any:
    value = table[key]
    accepted = (int, float) if kind is float else kind
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{key!r} is {value!r}")
    return value
