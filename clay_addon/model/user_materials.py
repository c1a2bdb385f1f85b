# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own materials: TOML files in Blender's user folder.

They have the format of those in ``presets/materials``: a label, and a ``[material]`` table with
the values of a `Material`.
"""

from __future__ import annotations

import json
import math
import os
import re
import time
import tomllib
import unicodedata
import zlib
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...solver.core.errors import TactileClayError
from ...solver.scene.material import MATERIAL_FIELDS, Material
from ..base.preferences import ADDON
from ..core.storage.atomic_files import replace_text

RESERVED_NAMES = ("CUSTOM", "SCENE")
"""Names that the interface uses for other items."""
MAX_LABEL_LENGTH = 40
"""Maximum number of characters in a label: more do not fit in the panel."""

_REFRESH_SECONDS = 1.0
"""Minimum time between two scans of the folder [s]: Blender redraws panels constantly."""
_DEVICE_NAMES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)$")


class UserMaterialError(TactileClayError):
    """A material cannot be saved or removed; the message says why and what to do."""


@dataclass(frozen=True)
class UserMaterial:
    """A material saved by the user."""

    name: str
    """Name of its file, without ``.toml``."""
    label: str
    """Name in the interface."""
    material: Material
    """Its values."""


@dataclass(frozen=True)
class UserMaterials:
    """The contents of a folder of materials."""

    materials: tuple[UserMaterial, ...]
    """The valid ones, sorted by name."""
    problems: tuple[str, ...]
    """A message for each invalid file, which names it."""


def material_number(name: str) -> int:
    """The number that a .blend stores for a preset, independent of which other presets exist."""
    return zlib.crc32(name.encode()) & 0xFFFFFF


def user_material_folder() -> Path:
    """The folder of the user's materials; it may not exist yet."""
    try:
        # Defined only if the add-on is installed as an extension.
        folder = bpy.utils.extension_path_user(ADDON, path="materials")
    except ValueError:
        folder = bpy.utils.user_resource("DATAFILES", path="tactile_clay/materials")
    return Path(folder)


def read_user_materials(folder: Path) -> UserMaterials:
    """Read all materials of a folder; invalid files do not affect the valid ones.

    Args:
        folder: The folder; one that does not exist counts as empty.
    """
    materials: list[UserMaterial] = []
    problems: list[str] = []
    taken = {material_number(name): name for name in Material.preset_names()}
    try:
        paths = sorted(folder.glob("*.toml"))
    except OSError as error:
        return UserMaterials((), (f"{folder} cannot be read: {error.strerror}.",))
    for path in paths:
        try:
            found = _read(path)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            named = reason if path.name in str(reason) else f"{path.name}: {reason}"
            problems.append(f"{named} Fix or delete the file.")
            continue
        number = material_number(found.name)
        if number in taken or found.name in RESERVED_NAMES:
            other = taken.get(number, found.name)
            problems.append(
                f"{path.name} conflicts with the preset {other!r}. Give the file another name."
            )
            continue
        taken[number] = found.name
        materials.append(found)
    return UserMaterials(tuple(materials), tuple(problems))


def _read(path: Path) -> UserMaterial:
    material = Material.from_toml(path)
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    for field in MATERIAL_FIELDS:
        value = getattr(material, field.name)
        if value is not None and value < field.minimum:
            raise ValueError(f"{field.name} is {value:g}; it must be at least {field.minimum:g}.")
    label = table.get("label", path.stem)
    if not isinstance(label, str) or not label.strip():
        raise ValueError(f"label is {label!r}; it must be a non-empty string.")
    return UserMaterial(path.stem, label.strip()[:MAX_LABEL_LENGTH], material)


class _MaterialCache:
    """The user's materials as last read, and when."""

    def __init__(self) -> None:
        self._read_at = -math.inf
        self._signature: object = None
        self._materials = UserMaterials((), ())

    def materials(self) -> UserMaterials:
        """The materials, at most a second old."""
        now = time.monotonic()
        if now - self._read_at >= _REFRESH_SECONDS:
            folder = user_material_folder()
            signature = (folder, _signature(folder))
            if signature != self._signature:
                self._signature, self._materials = signature, read_user_materials(folder)
            self._read_at = now
        return self._materials

    def forget(self) -> None:
        """Scan the folder again at the next request, however soon."""
        self._read_at, self._signature = -math.inf, None


_cache = _MaterialCache()


def user_materials() -> UserMaterials:
    """The user's materials, at most a second old."""
    return _cache.materials()


def _signature(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Names, modification times and sizes of the files, to detect changes."""
    try:
        with os.scandir(folder) as entries:
            found = [(entry.name, entry.stat()) for entry in entries]
    except OSError:
        return ()
    return tuple(sorted((name, stat.st_mtime_ns, stat.st_size) for name, stat in found))


def forget_user_materials() -> None:
    """Scan the folder again at the next request, however soon."""
    _cache.forget()


def save_user_material(label: str, material: Material, *, replace: bool = False) -> UserMaterial:
    """Write a material to the user's folder, atomically.

    Args:
        label: Name in the interface.
        material: Its values.
        replace: Whether to overwrite a material with the same name.

    Raises:
        UserMaterialError: The label is empty, not printable, too long or taken, or the file cannot
            be written.
    """
    label = " ".join(label.split())
    if not label.isprintable() or not label:
        raise UserMaterialError("The material needs a name of printable characters.")
    if len(label) > MAX_LABEL_LENGTH:
        raise UserMaterialError(
            f"The name has {len(label)} characters; use at most {MAX_LABEL_LENGTH}."
        )
    name = _file_name(label)
    if name in Material.preset_names():
        raise UserMaterialError(
            f"{label!r} is the name of a preset that comes with the extension. Choose another."
        )
    folder = user_material_folder()
    path = folder / f"{name}.toml"
    if path.exists() and not replace:
        raise UserMaterialError(
            f"There is already a material {label!r}. Choose another name, or enable Replace."
        )
    number = material_number(name)
    for other in (*Material.preset_names(), *(each.name for each in user_materials().materials)):
        if other != name and material_number(other) == number:
            raise UserMaterialError(f"{label!r} conflicts with {other!r}. Choose another name.")
    # For printable text, JSON and TOML strings are the same.
    text = f"label = {json.dumps(label, ensure_ascii=False)}\n\n{material.to_toml()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(path, text)
    except OSError as error:
        raise UserMaterialError(f"{path} cannot be written: {error.strerror}.") from error
    forget_user_materials()
    return UserMaterial(name, label, material)


def _file_name(label: str) -> str:
    """A file name valid on every file system, made from a label."""
    plain = unicodedata.normalize("NFKD", label).encode("ascii", "ignore").decode()
    name = re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")
    # If many letters have no ASCII form, a hash keeps names distinct.
    if name == "" or len(plain.strip()) < len(label) / 2:
        name = f"{name}_{zlib.crc32(label.encode()):08x}".strip("_")
    return f"{name}_" if _DEVICE_NAMES.match(name) else name


def remove_user_material(name: str) -> None:
    """Delete one of the user's materials.

    Args:
        name: Name of its file, without ``.toml``.

    Raises:
        UserMaterialError: There is no such material, or it cannot be deleted.
    """
    if name not in (each.name for each in read_user_materials(user_material_folder()).materials):
        raise UserMaterialError(
            f"{name!r} is not one of your materials. Only materials you saved can be removed."
        )
    path = user_material_folder() / f"{name}.toml"
    try:
        path.unlink()
    except OSError as error:
        raise UserMaterialError(f"{path} cannot be deleted: {error.strerror}.") from error
    forget_user_materials()
