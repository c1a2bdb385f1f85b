# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of the user's own: TOML files in a folder that Blender keeps for its user.

They look like those in ``presets/materials``: a label, and a ``[material]`` table with the values
of a `Material`.
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
"""Names that the interface uses for something else."""
LABEL_LENGTH = 40
"""Most letters in a label: more do not fit into the panel."""

_FRESH_SECONDS = 1.0
"""The folder is looked at no more often than this [s]: a panel is drawn constantly."""
_DEVICE_NAMES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)$")


class UserMaterialError(TactileClayError):
    """A material cannot be saved or removed; the message says why and what to do."""


@dataclass(frozen=True)
class UserMaterial:
    """A material that the user has saved."""

    name: str
    """Of its file, without ``.toml``."""
    label: str
    """What it is called in the interface."""
    material: Material
    """Its values."""


@dataclass(frozen=True)
class UserMaterials:
    """What a folder holds."""

    materials: tuple[UserMaterial, ...]
    """The good ones, by name."""
    problems: tuple[str, ...]
    """What is wrong with the others: a sentence each, that names the file."""


def material_number(name: str) -> int:
    """The number that a .blend keeps for a preset: the same whatever other presets there are."""
    return zlib.crc32(name.encode()) & 0xFFFFFF


def user_material_folder() -> Path:
    """Where the user's materials are; it need not be there yet."""
    try:
        # Known only where the add-on is installed as an extension.
        folder = bpy.utils.extension_path_user(ADDON, path="materials")
    except ValueError:
        folder = bpy.utils.user_resource("DATAFILES", path="tactile_clay/materials")
    return Path(folder)


def read_user_materials(folder: Path) -> UserMaterials:
    """Read all materials of a folder; a bad file keeps no good one away.

    Args:
        folder: Where they are; nothing is in one that does not exist.
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
            problems.append(f"{named} Mend or delete the file.")
            continue
        number = material_number(found.name)
        if number in taken or found.name in RESERVED_NAMES:
            other = taken.get(number, found.name)
            problems.append(
                f"{path.name} cannot be told from the preset {other!r}. Give the file another name."
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
        raise ValueError(f"label is {label!r}; it must be a text.")
    return UserMaterial(path.stem, label.strip()[:LABEL_LENGTH], material)


class _MaterialShelf:
    """The user's materials as they were last read."""

    def __init__(self) -> None:
        self._read_at = -math.inf
        self._signature: object = None
        self._materials = UserMaterials((), ())

    def materials(self) -> UserMaterials:
        """The materials, at most a second old."""
        now = time.monotonic()
        if now - self._read_at >= _FRESH_SECONDS:
            folder = user_material_folder()
            signature = (folder, _signature(folder))
            if signature != self._signature:
                self._signature, self._materials = signature, read_user_materials(folder)
            self._read_at = now
        return self._materials

    def forget(self) -> None:
        """Look at the folder again when next asked, however soon."""
        self._read_at, self._signature = -math.inf, None


_shelf = _MaterialShelf()


def user_materials() -> UserMaterials:
    """The user's materials, at most a second old."""
    return _shelf.materials()


def _signature(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Names, times and sizes of the files: what tells whether to read them again."""
    try:
        with os.scandir(folder) as entries:
            found = [(entry.name, entry.stat()) for entry in entries]
    except OSError:
        return ()
    return tuple(sorted((name, stat.st_mtime_ns, stat.st_size) for name, stat in found))


def forget_user_materials() -> None:
    """Look at the folder again when next asked, however soon."""
    _shelf.forget()


def save_user_material(label: str, material: Material, *, replace: bool = False) -> UserMaterial:
    """Write a material into the user's folder, whole or not at all.

    Args:
        label: What to call it.
        material: Its values.
        replace: Whether one of the same name may be overwritten.

    Raises:
        UserMaterialError: The label is empty, too long or taken, or the file cannot be written.
    """
    label = " ".join(label.split())
    if not label.isprintable() or not label:
        raise UserMaterialError("The material needs a name of letters, digits or signs.")
    if len(label) > LABEL_LENGTH:
        raise UserMaterialError(
            f"The name has {len(label)} letters; use at most {LABEL_LENGTH} of them."
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
            f"There is a material {label!r} already. Choose another name, or tick Replace."
        )
    number = material_number(name)
    for other in (*Material.preset_names(), *(each.name for each in user_materials().materials)):
        if other != name and material_number(other) == number:
            raise UserMaterialError(f"{label!r} cannot be told from {other!r}. Choose another.")
    # JSON's strings are TOML's, for printable text.
    text = f"label = {json.dumps(label, ensure_ascii=False)}\n\n{material.to_toml()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(path, text)
    except OSError as error:
        raise UserMaterialError(f"{path} cannot be written: {error.strerror}.") from error
    forget_user_materials()
    return UserMaterial(name, label, material)


def _file_name(label: str) -> str:
    """A name that every file system takes, from a label."""
    plain = unicodedata.normalize("NFKD", label).encode("ascii", "ignore").decode()
    name = re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")
    # Letters that have no plain form count, too.
    if name == "" or len(plain.strip()) < len(label) / 2:
        name = f"{name}_{zlib.crc32(label.encode()):08x}".strip("_")
    return f"{name}_" if _DEVICE_NAMES.match(name) else name


def remove_user_material(name: str) -> None:
    """Delete a material of the user's.

    Args:
        name: Of its file, without ``.toml``.

    Raises:
        UserMaterialError: There is none of that name, or it cannot be deleted.
    """
    if name not in (each.name for each in read_user_materials(user_material_folder()).materials):
        raise UserMaterialError(
            f"{name!r} is no material of yours. Only those that you have saved can be removed."
        )
    path = user_material_folder() / f"{name}.toml"
    try:
        path.unlink()
    except OSError as error:
        raise UserMaterialError(f"{path} cannot be deleted: {error.strerror}.") from error
    forget_user_materials()
