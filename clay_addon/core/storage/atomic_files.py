# SPDX-License-Identifier: GPL-3.0-or-later
"""Atomic file writing: a file is written completely or not at all."""

from __future__ import annotations

import errno
import os
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ....solver.core.errors import TactileClayError


class CacheError(TactileClayError):
    """A cache cannot be read or written; the message says why and what to do."""


class CacheMissingError(CacheError):
    """The cache, or a frame of it, is missing."""


class CacheDamagedError(CacheError):
    """A file of the cache is truncated, altered, or from another bake."""


def lock_file(handle: int) -> None:
    """Lock an open file until it is closed; do nothing if the file system does not support locks.

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


def read_arrays(path: Path, names: tuple[str, ...] | None = None) -> dict[str, NDArray[Any]]:
    """Read arrays from an .npz file and verify their checksums.

    Args:
        path: The file.
        names: Names of the arrays; all if omitted.

    Raises:
        CacheMissingError: The file does not exist.
        CacheDamagedError: The file is damaged, or an array is missing.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in names or archive.files}
    except FileNotFoundError:
        raise CacheMissingError(f"{path.name} is missing") from None
    except OSError as error:
        raise CacheDamagedError(
            f"{path.name} cannot be read ({error.strerror or error})"
        ) from error
    except (
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
        # numpy's own message suggests allowing pickle, which would be unsafe.
        raise CacheDamagedError(f"{path.name} is damaged") from error


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], *, durable: bool = True) -> None:
    """Write an .npz file atomically; see `write_atomically`."""

    # numpy gives every entry the same date, so equal arrays result in equal bytes.
    def save(file: IO[bytes]) -> None:
        np.savez(file, **arrays)  # type: ignore[arg-type]

    write_atomically(path, save, durable=durable)


def write_atomically(
    path: Path, write: Callable[[IO[bytes]], object], *, durable: bool = True
) -> None:
    """Write a file of a cache atomically; see `replace_file`.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    try:
        temporary = path.parent / f".clay-{os.getpid()}-{path.stem}.tmp"
        replace_file(path, temporary, write, durable=durable)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = (
                f"The disk is full: {path} could not be written. Frames baked so far are kept; "
                "free some space, then Resume."
            )
        else:
            message = f"{path} could not be written ({error.strerror or error})."
        raise CacheError(message) from error


def replace_file(
    path: Path, temporary: Path, write: Callable[[IO[bytes]], object], *, durable: bool = True
) -> None:
    """Write a file under a temporary name in the same folder, then rename it.

    Args:
        path: The file.
        temporary: Path of the temporary file.
        write: Writes the content to an open file.
        durable: Whether to wait until the file is on disk, so that it survives a power failure.

    Raises:
        OSError: The file cannot be written. An existing one is unchanged.
    """
    try:
        with temporary.open("wb") as file:
            write(file)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        temporary.replace(path)
        if durable:
            _sync_folder(path.parent)
    finally:
        # A read-only file system refuses removal even of a file that does not exist.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Write a text file atomically as UTF-8; see `replace_file`.

    Raises:
        OSError: The file cannot be written. An existing one is unchanged.
    """
    content = text.encode("utf-8")
    replace_file(path, path.with_name(f".{path.name}.part"), lambda file: file.write(content))


def _sync_folder(folder: Path) -> None:
    """Make a rename survive a power failure, on systems that support it."""
    if os.name != "posix":
        return
    # Some network file systems do not support it; the file exists all the same.
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
