# SPDX-License-Identifier: GPL-3.0-or-later
"""Digests of everything that affects the result of a bake, to detect what has changed since."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import bpy
import numpy as np

from ..base.units import meters_per_unit
from .clay_scene import (
    checked_material,
    clay_objects,
    clay_positions,
    frames_per_second,
    solver_settings,
)


def scene_digests(scene: bpy.types.Scene) -> dict[str, str]:
    """A digest for each subject that does not need the colliders to be evaluated.

    Raises:
        SimulationError: The clay cannot be simulated.
    """
    clay = clay_objects(scene)
    gravity = tuple(scene.gravity) if scene.use_gravity else (0.0, 0.0, 0.0)
    samples, edits = scene.tactile_clay.motion_samples, scene.tactile_clay.film_edits
    return {
        "clay": digest_of(clay_digest(clay), edits) if edits else clay_digest(clay),
        "materials": digest_of(*(asdict(checked_material(item)) for item in clay)),
        "solver settings": digest_of(asdict(solver_settings(scene))),
        "gravity": digest_of(*gravity),
        "frame rate": digest_of(frames_per_second(scene), *([samples] if samples > 1 else [])),
        "unit scale": digest_of(meters_per_unit(scene)),
    }


def clay_digest(clay: list[bpy.types.Object]) -> str:
    """A digest of the clay's starting shape, independent of the objects' names.

    Raises:
        SimulationError: The clay cannot be simulated.
    """
    return digest_of(*((item.tactile_clay.spacing, clay_positions(item)) for item in clay))


def digest_of(*values: Any) -> str:
    """A digest, as 32 hexadecimal digits, of arrays, tuples, mappings and plain values."""
    digest = hashlib.blake2b(digest_size=16)
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, tuple):
            digest.update(digest_of(*value).encode())
        elif isinstance(value, Mapping):
            digest.update(digest_of(*(repr(pair) for pair in sorted(value.items()))).encode())
        else:
            digest.update(repr(value).encode())
    return digest.hexdigest()
