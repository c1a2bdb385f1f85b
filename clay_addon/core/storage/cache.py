# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache of a bake: metadata, one file per frame, and checkpoints to resume from.

A cache folder holds ``meta.json``, ``colors.npz``, ``frame_000001.npz`` and so on, and
``checkpoint_000010.npz`` and so on. Every file is written under a temporary name in the same
folder, flushed to disk and then renamed, so no file is ever incomplete, even if the process is
killed. Positions are in world space and Blender units, as the viewport shows them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .atomic_files import (
    CacheDamagedError,
    CacheError,
    CacheMissingError,
    lock_file,
    read_arrays,
    write_arrays,
    write_atomically,
)
from .clay_layout import ClayLayout, ClaySlice
from .foci import FOCI
from .meta import Meta

__all__ = [
    "Cache",
    "CacheDamagedError",
    "CacheError",
    "CacheMissingError",
    "ClayLayout",
    "ClaySlice",
    "Frame",
    "Meta",
]

_FRAME = re.compile(r"frame_(-\d{5,}|\d{6,})\.npz")
_CHECKPOINT = re.compile(r"checkpoint_(-\d{5,}|\d{6,})\.npz")
_LOCK = "clay.lock"
_TEMPORARY = re.compile(r"\.clay-.*\.tmp")


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
    """Digest of the motion of colliders and hands up to this frame."""


class Cache:
    """A cache folder.

    The constructor does not access the disk.

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
        """Read the metadata of the bake.

        Raises:
            CacheMissingError: There is no bake in the folder.
            CacheDamagedError: ``meta.json`` is not valid.
        """
        try:
            text = self._meta_path.read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            raise CacheMissingError(f"there is no bake in {self.directory}") from None
        except (OSError, UnicodeDecodeError) as error:
            raise CacheDamagedError(f"{self._meta_path} cannot be read ({error})") from error
        return Meta.from_json(text)

    def frames(self) -> list[int]:
        """Sorted numbers of the frames that have a file, valid or not."""
        return self._numbers(_FRAME)

    def checkpoints(self) -> list[int]:
        """Sorted numbers of the frames that have a solver checkpoint."""
        return self._numbers(_CHECKPOINT)

    def read_frame(self, number: int, *, meta: Meta | None = None) -> Frame:
        """Read one frame, and check that it is intact and belongs to this bake.

        Args:
            number: Frame number.
            meta: Metadata of the bake; read from the folder if omitted.

        Raises:
            CacheMissingError: The frame is missing.
            CacheDamagedError: The file is truncated, altered or from another bake.
        """
        path = self.frame_path(number)
        arrays = read_arrays(path, ("bake", "frame", "inputs", "positions", "velocities"))
        meta = meta or self.meta()
        shape = (meta.particle_count, 3)
        if arrays["bake"].tobytes() != meta.digest or arrays["frame"].tolist() != [number]:
            raise CacheDamagedError(f"{path.name} belongs to another bake or frame")
        for name in ("positions", "velocities"):
            if arrays[name].shape != shape or arrays[name].dtype != np.float32:
                raise CacheDamagedError(f"{path.name} holds {name} of the wrong size")
        return Frame(number, arrays["positions"], arrays["velocities"], arrays["inputs"].tobytes())

    def foci_frames(self) -> list[int]:
        """Sorted numbers of the frames that have recorded focal points."""
        return self._numbers(FOCI)

    def read_colors(self) -> NDArray[np.float32]:
        """Read the colors of the particles, linear RGBA in 0 to 1, shape [N, 4].

        Raises:
            CacheMissingError: The file is missing.
            CacheDamagedError: The file is truncated or altered.
        """
        path = self.directory / "colors.npz"
        colors = read_arrays(path, ("colors",))["colors"]
        if colors.shape != (self.meta().particle_count, 4) or colors.dtype != np.float32:
            raise CacheDamagedError(f"{path.name} holds colors of the wrong size")
        return colors

    def read_checkpoint(self, number: int, *, meta: Meta | None = None) -> dict[str, Any]:
        """Read the solver's state after one frame.

        Raises:
            CacheMissingError: There is no such checkpoint.
            CacheDamagedError: The file is truncated, altered or from another bake.
        """
        path = self._checkpoint_path(number)
        arrays = read_arrays(path)
        meta = meta or self.meta()
        bake = arrays.pop("clay_cache_bake", np.zeros(0, np.uint8))
        if bake.tobytes() != meta.digest:
            raise CacheDamagedError(f"{path.name} belongs to another bake")
        return arrays

    def intact_frames(self, start: int, end: int) -> dict[int, Frame]:
        """The intact frames from `start` to `end`, without their particles, by number.

        Files that are truncated or from another bake count as missing.
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
        """Size on disk [bytes]."""
        size = 0
        for path in self._own_files():
            # Temporary files of another process that is baking may disappear.
            with suppress(FileNotFoundError):
                size += path.stat().st_size
        return size

    def frame_path(self, number: int) -> Path:
        """Path of a frame's file."""
        return self.directory / f"frame_{number:06d}.npz"

    # Writing ---------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Create the folder and check that it is writable, before any work is done.

        Removes temporary files left by a killed process.

        Raises:
            CacheError: The folder cannot be created or written to; the message says why.
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
        """Start a new bake: remove an earlier one, then write the colors and metadata.

        Raises:
            CacheError: The folder cannot be written to, or its meta.json is not from a bake.
        """
        self.prepare()
        self._check_own()
        self._remove()
        self.write_colors(colors)
        self.write_meta(meta)

    def write_colors(self, colors: NDArray[np.floating]) -> None:
        """Write the colors of the particles, linear RGBA in 0 to 1, shape [N, 4].

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        write_arrays(self.directory / "colors.npz", {"colors": colors.astype(np.float32)})

    def write_meta(self, meta: Meta) -> None:
        """Write ``meta.json``.

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        write_atomically(self._meta_path, lambda file: file.write(meta.to_json().encode()))

    def write_frame(self, frame: Frame, meta: Meta, *, durable: bool = True) -> None:
        """Write one frame.

        Args:
            frame: The frame.
            meta: Metadata of the bake.
            durable: Whether to wait until the file is on disk.

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        write_arrays(
            self.frame_path(frame.number),
            {
                "bake": np.frombuffer(meta.digest, np.uint8),
                "frame": np.array([frame.number], np.int64),
                "inputs": np.frombuffer(frame.inputs, np.uint8),
                "positions": np.ascontiguousarray(frame.positions, np.float32),
                "velocities": np.ascontiguousarray(frame.velocities, np.float32),
            },
            durable=durable,
        )

    def write_checkpoint(
        self, number: int, snapshot: Mapping[str, NDArray[Any]], meta: Meta
    ) -> int:
        """Write the solver's state after one frame, and return the file size [bytes].

        Raises:
            CacheError: The disk is full or the folder cannot be written to.
        """
        path = self._checkpoint_path(number)
        bake = np.frombuffer(meta.digest, np.uint8)
        write_arrays(path, {**snapshot, "clay_cache_bake": bake})
        return path.stat().st_size

    def free(self) -> int:
        """Remove the bake and return its size [bytes].

        Removes only files that a cache writes, and the folder if it is then empty.

        Raises:
            CacheError: A file cannot be removed, another process is baking there, or meta.json is
                not from a bake.
        """
        self._check_own()
        size = self.size()
        if self._own_files():
            with self.locked():
                self._remove()
        # A remaining lock file or empty folder does no harm.
        with suppress(OSError):
            (self.directory / _LOCK).unlink(missing_ok=True)
            self.directory.rmdir()
        return size

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing to the folder; call `prepare` first.

        The operating system releases the lock when the process ends, even if it is killed.

        Raises:
            CacheError: Another process is baking there, or the lock file cannot be created.
        """
        path = self.directory / _LOCK
        try:
            lock = path.open("a+b")
        except OSError as error:
            raise CacheError(
                f"{path} cannot be written to ({error.strerror}). Remove it."
            ) from error
        with lock:
            try:
                lock_file(lock.fileno())
            except BlockingIOError:
                raise CacheError(
                    f"Another process is baking into {self.directory}. Wait for it, or choose "
                    "another cache folder."
                ) from None
            yield

    # Internal --------------------------------------------------------------------------------

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
            or any(p.fullmatch(path.name) for p in (_FRAME, _CHECKPOINT, FOCI, _TEMPORARY))
        ]

    def _check_own(self) -> None:
        """Refuse a folder that contains a foreign meta.json and no files of a bake."""
        try:
            self.meta()
        except CacheMissingError:
            return
        except CacheDamagedError as error:
            if {path.name for path in self._own_files()} <= {"meta.json", _LOCK}:
                raise CacheError(
                    f"{self._meta_path} is not from a bake ({error}) and would be lost. Choose "
                    "another cache folder."
                ) from error

    def _remove(self) -> None:
        """Remove all files except the lock, which the caller holds."""
        # meta.json goes last, so that an interrupted removal leaves a bake with missing frames.
        for path in sorted(self._own_files(), key=lambda path: path.name == "meta.json"):
            if path.name == _LOCK:
                continue
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise CacheError(f"{path} cannot be removed ({error.strerror}).") from error
