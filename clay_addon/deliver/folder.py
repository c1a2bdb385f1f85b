# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a delivery, which is replaced as a whole and never overwrites other files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import bpy

from ...solver.core.errors import TactileClayError
from ..core.storage.atomic_files import lock_file

MANIFEST_NAME = "delivery.json"
"""File that describes a delivery, and marks its folder as replaceable."""


class DeliveryError(TactileClayError):
    """The clay cannot be delivered; the message says why and what to do."""


def resolve_folder(scene: bpy.types.Scene, directory: str | os.PathLike[str] | None = None) -> Path:
    """Absolute path of the folder for a scene's delivery.

    Raises:
        DeliveryError: No folder is set, it is relative to a .blend that was never saved, or it
            holds other files.
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
    if path.is_dir() and any(path.iterdir()) and not (path / MANIFEST_NAME).is_file():
        raise DeliveryError(
            f"{path} contains files that are not part of a delivery and would be lost. Choose "
            "another folder."
        )
    return path


@contextmanager
def partial_folder(target: Path) -> Iterator[Path]:
    """Create a folder beside the target, and remove it afterward unless it was moved.

    Raises:
        DeliveryError: Another process is delivering to the same folder.
        OSError: The folder cannot be created.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.partial")
    lock_path = target.with_name(f".{target.name}.lock")
    with lock_path.open("a+b") as lock:
        try:
            lock_file(lock.fileno())
        except BlockingIOError:
            raise DeliveryError(
                f"Another process is delivering to {target}. Wait for it, or choose another folder."
            ) from None
        # A killed process leaves its folder.
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        try:
            yield partial
        finally:
            shutil.rmtree(partial, ignore_errors=True)
            # Some systems cannot remove an open file; a remaining one does no harm.
            with suppress(OSError):
                lock_path.unlink()


def replace_folder(partial: Path, target: Path) -> None:
    """Replace the old delivery by the new one; if that fails, restore the old one."""
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
