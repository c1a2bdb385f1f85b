# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a delivery: it is there whole or not at all, and nothing else is in its way."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import bpy

from ...solver.core.errors import TactileClayError
from ..core.storage.atomic_files import lock_file

NOTE = "delivery.json"
"""Marks a folder as a delivery, which may be replaced, and says what is in it."""


class DeliveryError(TactileClayError):
    """The clay cannot be delivered; the message says why and what to do."""


def resolve_folder(scene: bpy.types.Scene, directory: str | os.PathLike[str] | None = None) -> Path:
    """The folder of a scene's delivery as an absolute path.

    Raises:
        DeliveryError: No folder is set, or it is relative to a .blend that was never saved.
    """
    text = os.fspath(directory) if directory is not None else scene.tactile_clay.delivery_directory
    if not text:
        raise DeliveryError("No folder for the delivery is set. Set one in the Delivery panel.")
    if text.startswith("//") and not bpy.data.filepath:
        raise DeliveryError(
            "The .blend was never saved, and its delivery goes into a folder beside it. Save the "
            "file first, or set an absolute folder."
        )
    path = Path(bpy.path.abspath(text)).absolute()
    if path.exists() and not path.is_dir():
        raise DeliveryError(f"{path} is a file. Choose a folder for the delivery.")
    if path.is_dir() and any(path.iterdir()) and not (path / NOTE).is_file():
        raise DeliveryError(
            f"{path} holds other files than a delivery. Choose another folder, so that they are "
            "not lost."
        )
    return path


@contextmanager
def partial_folder(target: Path) -> Iterator[Path]:
    """A folder beside the target that is gone afterwards, unless it was moved.

    Raises:
        DeliveryError: Another process delivers into the same folder.
        OSError: It cannot be made.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.partial")
    lock_path = target.with_name(f".{target.name}.lock")
    with lock_path.open("a+b") as lock:
        try:
            lock_file(lock.fileno())
        except BlockingIOError:
            raise DeliveryError(
                f"Another process is delivering into {target}. Wait for it, or choose another "
                "folder."
            ) from None
        # One that was killed leaves its folder.
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        try:
            yield partial
        finally:
            shutil.rmtree(partial, ignore_errors=True)
            # Some systems remove no file that is open; it does no harm.
            with suppress(OSError):
                lock_path.unlink()


def replace_folder(partial: Path, target: Path) -> None:
    """Put the new delivery in the place of the old one, which comes back if that fails."""
    old = target.with_name(f".{target.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if target.exists():
        target.rename(old)
    try:
        partial.rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
