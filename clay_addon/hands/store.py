# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores a bound hand in the .blend file, as a compressed custom property of its mesh.

The property follows the mesh: into duplicates, into libraries and through Undo.
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
    """Digest of the vertex weights."""
    source_digest: str
    """Digest of mesh, rest bones and scale."""


def is_stored(mesh: bpy.types.Mesh) -> bool:
    """Whether a mesh holds a bound hand."""
    return PROPERTY in mesh


def store_hand(mesh: bpy.types.Mesh, hand: StoredHand) -> None:
    """Store a bound hand in a mesh, replacing any earlier one."""
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {
        "version": np.array(_VERSION),
        "armature": hand.armature,
        "weights_digest": np.array(hand.weights_digest),
        **hand.rig.to_arrays(),
    }
    np.savez_compressed(buffer, **arrays)
    # Overwriting bytes with bytes of another length corrupts them (Blender 5.2).
    forget_hand(mesh)
    mesh[PROPERTY] = buffer.getvalue()
    mesh[SOURCE_PROPERTY] = hand.source_digest
    mesh[SPACING_PROPERTY] = hand.rig.ghost_spacing


def stored_source(mesh: bpy.types.Mesh) -> str:
    """The stored hand's source digest, without reading the hand; empty if there is none."""
    return str(mesh.get(SOURCE_PROPERTY, ""))


def stored_spacing(mesh: bpy.types.Mesh) -> float:
    """The stored hand's ghost spacing [m], without reading the hand; 0 if there is none."""
    return float(mesh.get(SPACING_PROPERTY, 0.0))


def load_hand(mesh: bpy.types.Mesh) -> StoredHand:
    """Read the hand written by `store_hand`.

    Raises:
        ValueError: There is none, it is corrupt, or a newer version of the add-on wrote it.
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
        raise ValueError(f"its stored binding is corrupt ({error})") from error
    if rig is None:
        raise ValueError("it was bound by a newer version of Tactile Clay")
    return StoredHand(rig, arrays["armature"], str(arrays["weights_digest"]), stored_source(mesh))


def forget_hand(mesh: bpy.types.Mesh) -> None:
    """Delete the hand stored in a mesh."""
    for name in (PROPERTY, SOURCE_PROPERTY, SPACING_PROPERTY):
        if name in mesh:
            del mesh[name]
