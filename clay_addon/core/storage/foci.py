# SPDX-License-Identifier: GPL-3.0-or-later
"""Focal points recorded with a bake: one file ``foci_000001.npz`` for each frame with touch."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .atomic_files import CacheDamagedError, read_arrays, write_arrays
from .meta import Meta

FOCI = re.compile(r"foci_(-\d{5,}|\d{6,})\.npz")
"""Matches the names of these files."""


@dataclass(frozen=True)
class FociFrame:
    """Focal points of an ultrasound array at one frame."""

    number: int
    """Frame number."""
    positions: NDArray[np.float32]
    """World positions [Blender units], shape [K, 3]."""
    pressures: NDArray[np.float32]
    """Pressure amplitudes [Pa], shape [K]."""
    sigma: float
    """Size of a focal point: the standard deviation of its Gaussian [m]."""


def foci_path(directory: Path, number: int) -> Path:
    """Path of a frame's file."""
    return directory / f"foci_{number:06d}.npz"


def write_foci(directory: Path, frame: FociFrame, meta: Meta) -> None:
    """Write the focal points of one frame.

    Args:
        directory: The cache folder.
        frame: The focal points.
        meta: Metadata of the bake.

    Raises:
        CacheError: The disk is full or the folder cannot be written to.
    """
    write_arrays(
        foci_path(directory, frame.number),
        {
            "bake": np.frombuffer(meta.digest, np.uint8),
            "frame": np.array([frame.number], np.int64),
            "positions": np.ascontiguousarray(frame.positions, np.float32),
            "pressures": np.ascontiguousarray(frame.pressures, np.float32),
            "sigma": np.array([frame.sigma], np.float32),
        },
    )


def read_foci(directory: Path, number: int, meta: Meta) -> FociFrame:
    """Read the focal points of one frame.

    Args:
        directory: The cache folder.
        number: Frame number.
        meta: Metadata of the bake.

    Raises:
        CacheMissingError: None were recorded at this frame.
        CacheDamagedError: The file is truncated, altered or from another bake.
    """
    path = foci_path(directory, number)
    arrays = read_arrays(path, ("bake", "frame", "positions", "pressures", "sigma"))
    if arrays["bake"].tobytes() != meta.digest or arrays["frame"].tolist() != [number]:
        raise CacheDamagedError(f"{path.name} belongs to another bake or frame")
    positions, pressures, sigma = (arrays[n] for n in ("positions", "pressures", "sigma"))
    values = positions, pressures, sigma
    count = len(pressures) if pressures.ndim else -1
    shapes = [each.shape for each in values]
    if shapes != [(count, 3), (count,), (1,)] or {each.dtype for each in values} != {
        np.dtype(np.float32)
    }:
        raise CacheDamagedError(f"{path.name} holds focal points of the wrong size")
    if not all(np.isfinite(each).all() for each in values):
        raise CacheDamagedError(f"{path.name} holds values that are not finite")
    return FociFrame(number, positions, pressures, float(sigma[0]))
