# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake on disk: one file a frame, checkpoints to resume from, and what they were made with.

A cache folder holds ``meta.json``, ``colors.npz``, ``frame_000001.npz`` and so on, and
``checkpoint_000010.npz``. Every file is written under a temporary name in the same folder, flushed
to the disk and then renamed, so a file is there whole or not at all whenever the process dies.
Positions are in world space and Blender units, as the viewport shows them.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMAT_VERSION = 1

_FRAME = re.compile(r"frame_(-\d{5,}|\d{6,})\.npz")
_CHECKPOINT = re.compile(r"checkpoint_(-\d{5,}|\d{6,})\.npz")
_LOCK = "clay.lock"
_TEMPORARY = re.compile(r"\.clay-.*\.tmp")


class CacheError(Exception):
    """A cache cannot be read or written; the message says why and what to do."""


class CacheMissingError(CacheError):
    """The cache, or a frame of it, is not there."""


class CacheDamagedError(CacheError):
    """A file of the cache is truncated, altered, or not of this bake."""


@dataclass(frozen=True)
class ClaySlice:
    """One clay object's part of every frame."""

    name: str
    """The object's name."""
    count: int
    """Number of its particles; the objects follow each other in the order of the list."""


@dataclass(frozen=True)
class Meta:
    """What a bake was made from, as kept in ``meta.json``."""

    start: int
    """First frame: the rest state."""
    end: int
    """Last frame that was asked for."""
    frames_per_second: float
    """Frames in one second of simulated time [1/s]."""
    clay: tuple[ClaySlice, ...]
    """The clay objects, in the order of the particles."""
    settings: Mapping[str, str]
    """A digest for each subject that decides the result, so that a change can be named."""
    owner: str = ""
    """The .blend file and scene the bake belongs to."""
    version: str = ""
    """Version of the add-on that made it."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """Figures of the last bake, for reports."""

    @property
    def particle_count(self) -> int:
        """Number of particles in every frame."""
        return sum(part.count for part in self.clay)

    @property
    def digest(self) -> bytes:
        """Sixteen bytes that every frame file of this bake carries."""
        text = json.dumps(
            [FORMAT_VERSION, self.start, self.particle_count, sorted(self.settings.items())]
        )
        return hashlib.blake2b(text.encode(), digest_size=16).digest()

    def to_json(self) -> str:
        """The text of ``meta.json``."""
        table = {"format_version": FORMAT_VERSION, "particle_count": self.particle_count}
        table.update(asdict(self))
        return json.dumps(table, indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Meta:
        """Read the text of ``meta.json``.

        Raises:
            CacheDamagedError: The text is not what `to_json` writes.
        """
        try:
            table = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise CacheDamagedError(f"meta.json is not valid JSON ({error})") from error
        if not isinstance(table, dict):
            raise CacheDamagedError("meta.json holds no table")
        version = table.get("format_version")
        if version != FORMAT_VERSION:
            raise CacheDamagedError(
                f"the cache has format {version!r}, this add-on reads {FORMAT_VERSION}; bake again"
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
            raise CacheDamagedError(f"meta.json lacks or garbles an entry: {error}") from error
        sane = meta.end >= meta.start and all(part.count > 0 for part in clay)
        if not sane or not math.isfinite(meta.frames_per_second) or meta.frames_per_second <= 0:
            raise CacheDamagedError("meta.json has values that make no sense")
        if table.get("particle_count") != meta.particle_count:
            raise CacheDamagedError("meta.json's particle counts disagree")
        return meta


def _typed(table: Any, key: str, kind: type) -> Any:
    value = table[key]
    accepted = (int, float) if kind is float else kind
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{key!r} is {value!r}")
    return value


@dataclass(frozen=True)
class Frame:
    """The particles at one frame."""

    number: int
    """Frame number."""
    positions: NDArray[np.float32]
    """World positions [Blender units], shape [N, 3]."""
    velocities: NDArray[np.float32]
    """World velocities [Blender units/s], shape [N, 3]."""
    inputs: bytes = b""
    """Digest of what the colliders did at this frame."""


class Cache:
    """A cache folder.

    Making a `Cache` touches nothing on the disk.

    Example:
        >>> cache = Cache("clay_cache")
        >>> for number in cache.frames():
        ...     positions = cache.read_frame(number).positions
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self.directory = Path(directory)

    # Reading ---------------------------------------------------------------------------------

    def exists(self) -> bool:
        """Whether the folder holds a bake."""
        return self._meta_path.is_file()

    def meta(self) -> Meta:
        """What the bake was made from.

        Raises:
            CacheMissingError: There is no bake in the folder.
            CacheDamagedError: ``meta.json`` cannot be understood.
        """
        try:
            text = self._meta_path.read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            raise CacheMissingError(f"there is no bake in {self.directory}") from None
        except (OSError, UnicodeDecodeError) as error:
            raise CacheDamagedError(f"{self._meta_path} cannot be read ({error})") from error
        return Meta.from_json(text)

    def frames(self) -> list[int]:
        """Numbers of the frames that have a file, sorted; `read_frame` tells which are whole."""
        return self._numbers(_FRAME)

    def checkpoints(self) -> list[int]:
        """Numbers of the frames that have a solver checkpoint, sorted."""
        return self._numbers(_CHECKPOINT)

    def read_frame(self, number: int, *, meta: Meta | None = None) -> Frame:
        """Read one frame, and check that it is whole and belongs to this bake.

        Args:
            number: Frame number.
            meta: The bake's `meta`, to save reading it again.

        Raises:
            CacheMissingError: The frame is not there.
            CacheDamagedError: The file is truncated, altered or of another bake.
        """
        path = self.frame_path(number)
        arrays = _read_arrays(path, ("bake", "frame", "inputs", "positions", "velocities"))
        meta = meta or self.meta()
        shape = (meta.particle_count, 3)
        if arrays["bake"].tobytes() != meta.digest or arrays["frame"].tolist() != [number]:
            raise CacheDamagedError(f"{path.name} belongs to another bake or frame")
        for name in ("positions", "velocities"):
            if arrays[name].shape != shape or arrays[name].dtype != np.float32:
                raise CacheDamagedError(f"{path.name} holds {name} of the wrong size")
        return Frame(number, arrays["positions"], arrays["velocities"], arrays["inputs"].tobytes())

    def read_colors(self) -> NDArray[np.float32]:
        """Colours of the particles, linear RGBA in 0 to 1, shape [N, 4].

        Raises:
            CacheMissingError: They are not there.
            CacheDamagedError: The file is truncated or altered.
        """
        path = self.directory / "colors.npz"
        colors = _read_arrays(path, ("colors",))["colors"]
        if colors.shape != (self.meta().particle_count, 4) or colors.dtype != np.float32:
            raise CacheDamagedError(f"{path.name} holds colours of the wrong size")
        return colors

    def read_checkpoint(self, number: int, *, meta: Meta | None = None) -> dict[str, Any]:
        """Read the solver's state after one frame.

        Raises:
            CacheMissingError: There is no such checkpoint.
            CacheDamagedError: The file is truncated, altered or of another bake.
        """
        path = self._checkpoint_path(number)
        arrays = _read_arrays(path)
        meta = meta or self.meta()
        bake = arrays.pop("clay_cache_bake", np.zeros(0, np.uint8))
        if bake.tobytes() != meta.digest:
            raise CacheDamagedError(f"{path.name} belongs to another bake")
        return arrays

    def whole_frames(self, start: int, end: int) -> dict[int, Frame]:
        """The frames from `start` to `end` that can be read, without their particles.

        Files that are truncated or of another bake count as missing.
        """
        meta = self.meta()
        found = {}
        empty = np.zeros((0, 3), np.float32)
        for number in self.frames():
            if start <= number <= end:
                try:
                    frame = self.read_frame(number, meta=meta)
                except CacheError:
                    continue
                found[number] = Frame(number, empty, empty, frame.inputs)
        return found

    def size(self) -> int:
        """Bytes on the disk."""
        return sum(path.stat().st_size for path in self._own_files())

    def frame_path(self, number: int) -> Path:
        """The file of one frame."""
        return self.directory / f"frame_{number:06d}.npz"

    # Writing ---------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Make the folder and prove that it can be written to, before any work is done.

        Leftovers of a process that was killed while it wrote are removed.

        Raises:
            CacheError: The folder cannot be made or written to; the message says why.
        """
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            for path in self.directory.iterdir():
                if _TEMPORARY.fullmatch(path.name):
                    path.unlink(missing_ok=True)
            probe = self.directory / f".clay-{os.getpid()}-probe.tmp"
            probe.write_bytes(b"clay")
            probe.unlink()
        except OSError as error:
            raise CacheError(
                f"The cache folder {self.directory} cannot be written to "
                f"({error.strerror or error}). Choose another folder, or change its permissions."
            ) from error

    def begin(self, meta: Meta, colors: NDArray[np.floating]) -> None:
        """Start a bake afresh: remove what an earlier one left and write what this one is.

        Raises:
            CacheError: The folder cannot be written to.
        """
        self.prepare()
        self._remove(keep_folder=True)
        _write_arrays(self.directory / "colors.npz", {"colors": colors.astype(np.float32)})
        self.write_meta(meta)

    def write_meta(self, meta: Meta) -> None:
        """Write ``meta.json``.

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        _write_whole(self._meta_path, lambda file: file.write(meta.to_json().encode()))

    def write_frame(self, frame: Frame, meta: Meta) -> None:
        """Write one frame.

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        _write_arrays(
            self.frame_path(frame.number),
            {
                "bake": np.frombuffer(meta.digest, np.uint8),
                "frame": np.array([frame.number], np.int64),
                "inputs": np.frombuffer(frame.inputs, np.uint8),
                "positions": np.ascontiguousarray(frame.positions, np.float32),
                "velocities": np.ascontiguousarray(frame.velocities, np.float32),
            },
        )

    def write_checkpoint(
        self, number: int, snapshot: Mapping[str, NDArray[Any]], meta: Meta
    ) -> int:
        """Write the solver's state after one frame, and return its size in bytes.

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        path = self._checkpoint_path(number)
        bake = np.frombuffer(meta.digest, np.uint8)
        _write_arrays(path, {**snapshot, "clay_cache_bake": bake})
        return path.stat().st_size

    def remove_checkpoint(self, number: int) -> None:
        """Remove one checkpoint, if it is there."""
        self._checkpoint_path(number).unlink(missing_ok=True)

    def free(self) -> int:
        """Remove the bake and return how many bytes that freed.

        Only files a cache writes are removed, and the folder if nothing else is in it.

        Raises:
            CacheError: A file cannot be removed.
        """
        size = self.size()
        try:
            self._remove(keep_folder=False)
        except OSError as error:
            raise CacheError(
                f"The cache folder {self.directory} cannot be emptied ({error.strerror})."
            ) from error
        return size

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing to the folder; call `prepare` before.

        The system takes the lock away with the process, so one that was killed leaves none.

        Raises:
            CacheError: Another process is baking there.
        """
        path = self.directory / _LOCK
        with path.open("a+b") as file:
            try:
                _lock_file(file.fileno())
            except BlockingIOError:
                raise CacheError(
                    f"Another process is baking into {self.directory}. Wait for it, or choose "
                    "another cache folder."
                ) from None
            yield

    # Inside ----------------------------------------------------------------------------------

    @property
    def _meta_path(self) -> Path:
        return self.directory / "meta.json"

    def _checkpoint_path(self, number: int) -> Path:
        return self.directory / f"checkpoint_{number:06d}.npz"

    def _numbers(self, pattern: re.Pattern[str]) -> list[int]:
        try:
            names = [path.name for path in self.directory.iterdir()]
        except OSError:
            return []
        return sorted(int(match[1]) for name in names if (match := pattern.fullmatch(name)))

    def _own_files(self) -> list[Path]:
        try:
            paths = list(self.directory.iterdir())
        except OSError:
            return []
        return [
            path
            for path in paths
            if path.name in ("meta.json", "colors.npz", _LOCK)
            or any(p.fullmatch(path.name) for p in (_FRAME, _CHECKPOINT, _TEMPORARY))
        ]

    def _remove(self, *, keep_folder: bool) -> None:
        # The frames go first: while meta.json is there, an interrupted removal still reads as a
        # bake with missing frames.
        for path in sorted(self._own_files(), key=lambda path: path.name == "meta.json"):
            if path.name != _LOCK or not keep_folder:
                path.unlink(missing_ok=True)
        if not keep_folder and self.directory.is_dir() and not any(self.directory.iterdir()):
            self.directory.rmdir()


def _lock_file(handle: int) -> None:
    """Lock an open file until it is closed; do nothing where the file system knows no locks.

    Raises:
        BlockingIOError: Another process holds the lock.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK):
            raise BlockingIOError from error


def _read_arrays(path: Path, names: tuple[str, ...] | None = None) -> dict[str, NDArray[Any]]:
    """Read an .npz file whole: the checksum of each array in it is verified on the way."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in names or archive.files}
    except FileNotFoundError:
        raise CacheMissingError(f"{path.name} is missing") from None
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        RuntimeError,
        TypeError,
        AttributeError,
        SyntaxError,
        MemoryError,
        OverflowError,
        NotImplementedError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise CacheDamagedError(f"{path.name} is damaged ({error})") from error


def _write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    # numpy stamps every entry with the same date, so equal arrays make equal bytes.
    _write_whole(path, lambda file: np.savez(file, **arrays))  # type: ignore[arg-type]


def _write_whole(path: Path, write: Any) -> None:
    """Write a file so that it is there whole or not at all, whatever happens on the way."""
    temporary = path.parent / f".clay-{os.getpid()}-{path.stem}.tmp"
    try:
        with temporary.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = (
                f"The disk is full: {path} could not be written. Frames baked so far are kept; "
                "free some space, then Resume."
            )
        else:
            message = f"{path} could not be written ({error.strerror or error})."
        raise CacheError(message) from error
    finally:
        temporary.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut, where the system can do that."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
