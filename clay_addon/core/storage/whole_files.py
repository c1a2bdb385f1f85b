# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are there whole or not at all, whatever happens while they are written."""

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
    """The cache, or a frame of it, is not there."""


class CacheDamagedError(CacheError):
    """A file of the cache is truncated, altered, or not of this bake."""


def lock_file(handle: int) -> None:
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


def read_arrays(path: Path, names: tuple[str, ...] | None = None) -> dict[str, NDArray[Any]]:
    """Read an .npz file whole: the checksum of each array in it is verified on the way."""
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
        # numpy's own words advise to unpickle what may be harmful.
        raise CacheDamagedError(f"{path.name} is damaged") from error


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], *, lasting: bool = True) -> None:
    """Write an .npz file whole or not at all; see `write_whole`."""

    # numpy stamps every entry with the same date, so equal arrays make equal bytes.
    def save(file: IO[bytes]) -> None:
        np.savez(file, **arrays)  # type: ignore[arg-type]

    write_whole(path, save, lasting=lasting)


def write_whole(path: Path, write: Callable[[IO[bytes]], object], *, lasting: bool = True) -> None:
    """Write a file so that it is there whole or not at all, whatever happens on the way.

    Args:
        path: The file.
        write: Writes it.
        lasting: Whether it also survives a power cut right afterward, which takes longer.
    """
    try:
        temporary = path.parent / f".clay-{os.getpid()}-{path.stem}.tmp"
        replace_file(path, temporary, write, lasting=lasting)
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
    path: Path, temporary: Path, write: Callable[[IO[bytes]], object], *, lasting: bool = True
) -> None:
    """Write a file under a temporary name in the same folder, then rename it.

    Args:
        path: The file.
        temporary: The other name.
        write: Writes it.
        lasting: Whether to wait until the disk has it.

    Raises:
        OSError: It cannot be written. A file that was there is as it was.
    """
    try:
        with temporary.open("wb") as file:
            write(file)
            file.flush()
            if lasting:
                os.fsync(file.fileno())
        temporary.replace(path)
        if lasting:
            _sync_folder(path.parent)
    finally:
        # A file system that takes no file refuses to remove one too, also one that is not there.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all; see `replace_file`.

    Args:
        path: The file.
        text: What it holds, written as UTF-8.

    Raises:
        OSError: It cannot be written. A file that was there is as it was.
    """
    content = text.encode("utf-8")
    replace_file(path, path.with_name(f".{path.name}.part"), lambda file: file.write(content))


def _sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut, where the system can do that."""
    if os.name != "posix":
        return
    # Some network file systems cannot; the file is there all the same.
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
