# SPDX-License-Identifier: GPL-3.0-or-later
"""Perceptual weights: how sensitive each part of a hand is to touch.

The paper sets α = 1 at the finger pads and lets it decay with the distance from the closest pad,
"following roughly mechanoreceptor densities" (Barreiro, Torres, Otaduy, WHC 2021, section IV-B).
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...solver.hand.rig import HandRig
from ..acoustics.small_product import small_product
from .finger_pads import FingerPads, find_finger_pads
from .geodesic import geodesic_distances

_PRESET = Path(__file__).resolve().parents[2] / "presets" / "haptics" / "skin_sensitivity.toml"

_CHUNK = 64

Real = NDArray[np.float64]


@dataclass(frozen=True)
class ReceptorDensity:
    """Density of mechanoreceptors as a function of the distance d from the nearest finger pad.

    Relative to the pads it is α(d) = f + (1 − f) sech(d / L): smooth, 1 at the pads, and decaying
    to f, the density of the palm. L is chosen so that the mean of α over the length of a finger is
    the density of the finger.

    Raises:
        ValueError: The densities do not decrease from fingertip to finger to palm.
    """

    fingertip: float
    """Tactile fibers in the skin of a finger pad [1/cm²]."""
    finger: float
    """Tactile fibers in the rest of the finger [1/cm²]."""
    palm: float
    """Tactile fibers in the palm [1/cm²]."""

    def __post_init__(self) -> None:
        if not (self.fingertip > self.finger > self.palm > 0.0 and math.isfinite(self.fingertip)):
            raise ValueError(
                "Receptor densities must decrease from fingertip to finger to palm and be above 0, "
                f"not {self.fingertip!r}, {self.finger!r}, {self.palm!r}."
            )

    def decay_length(self, finger_length: float) -> float:
        """The length L [m] for a given distance from pad to knuckle [m].

        A solution always exists: as L grows, the mean of sech rises from 0 to 1.
        """
        floor = self.palm / self.fingertip
        wanted = (self.finger / self.fingertip - floor) / (1.0 - floor)
        low, high = 1e-3 * finger_length, 1e3 * finger_length
        for _ in range(80):
            middle = math.sqrt(low * high)
            mean = 2.0 * math.atan(math.tanh(0.5 * finger_length / middle)) * middle / finger_length
            low, high = (middle, high) if mean < wanted else (low, middle)
        return high

    def weights(self, distances: ArrayLike, finger_length: float) -> Real:
        """α at distances from the nearest pad [m], same shape; f at infinite distance."""
        floor = self.palm / self.fingertip
        ratio = np.asarray(distances, np.float64) / self.decay_length(finger_length)
        return np.asarray(floor + (1.0 - floor) / np.cosh(np.minimum(ratio, 300.0)))

    @classmethod
    def preset(cls) -> ReceptorDensity:
        """Read the densities that ship with the project (``presets/haptics``).

        Raises:
            ValueError: The file is damaged.
        """
        try:
            values = tomllib.loads(_PRESET.read_text(encoding="utf-8"))["density"]
            return cls(**{name: float(values[name]) for name in ("fingertip", "finger", "palm")})
        except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{_PRESET.name} is damaged: {error!r}.") from error


@dataclass(frozen=True, eq=False)
class SkinSensitivity:
    """Perceptual weights of a bound hand, computed once.

    Example:
        >>> skin = SkinSensitivity.of(rig)
        >>> field = PressureField.from_contacts(contacts, array.position, weights=skin.ghosts)
    """

    vertices: Real
    """Weight α of each vertex of the skin, for a color attribute, shape [V]."""
    ghosts: Real
    """Weight α of each ghost, shape [G]."""
    distances: Real
    """Distance of each vertex along the skin from the nearest pad [m], shape [V]."""
    pads: FingerPads
    """The finger pads."""

    @classmethod
    def of(cls, rig: HandRig, density: ReceptorDensity | None = None) -> SkinSensitivity:
        """Compute the weights for any hand whose bones are named after fingers.

        Args:
            rig: The bound hand.
            density: Receptor densities; the preset if None.

        Raises:
            ValueError: No finger was found; the message says which bone names are understood.
        """
        density = density or ReceptorDensity.preset()
        pads = find_finger_pads(rig)
        distances = geodesic_distances(rig.vertices, rig.faces, pads.vertices)
        vertices = density.weights(distances, pads.finger_length)
        ghosts = _interpolated(rig.vertices, rig.faces, vertices, rig.carried_ghosts(rig.nodes))
        return cls(vertices, ghosts, distances, pads)


def _interpolated(vertices: Real, faces: NDArray[np.integer], values: Real, points: Real) -> Real:
    """Values at the surface points nearest to `points`, linear over triangles, shape [P].

    Only triangles around the nearest vertex are tried, which is enough for regular triangles.
    """
    corners = np.asarray(faces).ravel()
    order = np.argsort(corners, kind="stable")
    valence = np.bincount(corners, minlength=len(vertices))
    first = np.cumsum(valence) - valence
    place = np.minimum(np.arange(valence.max()), np.maximum(valence, 1)[:, None] - 1)
    around = order[np.minimum(first[:, None] + place, len(order) - 1)] // 3
    middle = vertices.mean(0)
    lines = np.ascontiguousarray((vertices - middle).T, np.float32)
    squares = np.where(valence > 0, 0.5 * np.square(lines).sum(0), np.inf).astype(np.float32)
    result = np.empty(len(points))
    for begin in range(0, len(points), _CHUNK):
        part = points[begin : begin + _CHUNK]
        score = small_product((part - middle).astype(np.float32), lines)
        score -= squares
        nearest = score.argmax(1)
        triangles = np.asarray(faces)[around[nearest]]
        count = triangles.shape[1]
        shares, square = _closest(
            np.repeat(part, count, axis=0), vertices[triangles].reshape(-1, 3, 3)
        )
        best = square.reshape(-1, count).argmin(1)
        rows = np.arange(len(part))
        chosen = shares.reshape(-1, count, 3)[rows, best]
        result[begin : begin + _CHUNK] = (chosen * values[triangles[rows, best]]).sum(1)
    return result


def _closest(points: Real, triangles: Real) -> tuple[Real, Real]:
    """Barycentric coordinates of the closest point in each triangle, and squared distance [m²]."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.square(normal).sum(1), 1e-30)
    shares = np.stack(
        [
            (np.cross(c - b, points - b) * normal).sum(1) / size,
            (np.cross(a - c, points - c) * normal).sum(1) / size,
            (np.cross(b - a, points - a) * normal).sum(1) / size,
        ],
        axis=1,
    )
    above = np.square(np.einsum("tk,tkd->td", shares, triangles) - points).sum(1)
    best = np.where((shares < 0.0).any(1), np.inf, above)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, edge = triangles[:, first], triangles[:, second] - triangles[:, first]
        length = np.maximum(np.square(edge).sum(1), 1e-30)
        along = np.clip(((points - start) * edge).sum(1) / length, 0.0, 1.0)
        square = np.square(start + along[:, None] * edge - points).sum(1)
        nearer = square < best
        best = np.where(nearer, square, best)
        shares[nearer] = 0.0
        shares[nearer, first] = 1.0 - along[nearer]
        shares[nearer, second] = along[nearer]
    return shares, best
