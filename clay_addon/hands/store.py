# SPDX-License-Identifier: GPL-3.0-or-later
"""What a .blend keeps of a bound hand: one compressed property on its mesh.

It goes where the mesh goes: into duplicates, into libraries and through Undo.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.hand.rig import HandRig

PROPERTY = "tactile_clay_hand"
SOURCE_PROPERTY = f"{PROPERTY}_source"
SPACING_PROPERTY = f"{PROPERTY}_ghost_spacing"
_VERSION = 1


@dataclass(frozen=True)
class StoredHand:
    """A bound hand, and what it was bound from."""

    rig: HandRig
    """The hand [m], in world coordinates at the time of binding."""
    armature: NDArray[np.float64]
    """World from armature at that time [m], shape [4, 4]."""
    weights_digest: str
    """Of the vertex weights."""
    source_digest: str
    """Of mesh, skeleton and size as they are in the file."""


def is_stored(mesh: bpy.types.Mesh) -> bool:
    """Whether a mesh holds a bound hand."""
    return PROPERTY in mesh


def store_hand(mesh: bpy.types.Mesh, hand: StoredHand) -> None:
    """Keep a bound hand on a mesh, in place of the one that it may have."""
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {
        "version": np.array(_VERSION),
        "armature": hand.armature,
        "weights_digest": np.array(hand.weights_digest),
        **hand.rig.to_arrays(),
    }
    np.savez_compressed(buffer, **arrays)
    # Assigning over bytes of another length spoils them (Blender 5.2).
    forget_hand(mesh)
    mesh[PROPERTY] = buffer.getvalue()
    mesh[SOURCE_PROPERTY] = hand.source_digest
    mesh[SPACING_PROPERTY] = hand.rig.ghost_spacing


def stored_source(mesh: bpy.types.Mesh) -> str:
    """The digest of what the mesh's hand was bound from, without reading the hand itself."""
    return str(mesh.get(SOURCE_PROPERTY, ""))


def stored_spacing(mesh: bpy.types.Mesh) -> float:
    """Distance of the ghosts of the mesh's hand [m], without reading the hand itself."""
    return float(mesh.get(SPACING_PROPERTY, 0.0))


def load_hand(mesh: bpy.types.Mesh) -> StoredHand:
    """Read the hand that `store_hand` kept.

    Raises:
        ValueError: There is none, it is damaged, or a newer version of the add-on wrote it.
    """
    if PROPERTY not in mesh:
        raise ValueError("it is not bound")
    try:
        with np.load(io.BytesIO(bytes(mesh[PROPERTY])), allow_pickle=False) as file:
            version = int(file["version"])
            arrays = {name: file[name] for name in file.files} if version <= _VERSION else {}
            rig = HandRig.from_arrays(arrays) if arrays else None
    except (
        KeyError,
        OSError,
        TypeError,
        ValueError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(f"what the file keeps of it is damaged ({error})") from error
    if rig is None:
        raise ValueError("a newer version of Tactile Clay bound it")
    return StoredHand(rig, arrays["armature"], str(arrays["weights_digest"]), stored_source(mesh))


def forget_hand(mesh: bpy.types.Mesh) -> None:
    """Drop the hand that a mesh holds."""
    for name in (PROPERTY, SOURCE_PROPERTY, SPACING_PROPERTY):
        if name in mesh:
            del mesh[name]
