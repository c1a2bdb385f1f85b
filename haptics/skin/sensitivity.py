# SPDX-License-Identifier: GPL-3.0-or-later
"""Perceptual weights: how much touch counts on each part of a hand.

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
    """Density of mechanoreceptors against the distance from the nearest finger pad.

    Over that at the pads it is α(d) = f + (1 − f) sech(d / L): 1 at the pads with no kink, towards
    the palm's share f. L is such that α has, on average over the length of a finger, that of the
    finger's main part.

    Raises:
        ValueError: The densities do not fall from fingertip to finger to palm.
    """

    fingertip: float
    """Touch fibres in the skin of a finger's pad [1/cm²]."""
    finger: float
    """In the rest of the finger."""
    palm: float
    """In the palm."""

    def __post_init__(self) -> None:
        if not (self.fingertip > self.finger > self.palm > 0.0 and math.isfinite(self.fingertip)):
            raise ValueError(
                "Receptor densities must fall from fingertip to finger to palm and be above 0, "
                f"not {self.fingertip!r}, {self.finger!r}, {self.palm!r}."
            )
        # Of sech alone the mean over a finger is at most 1: the two always meet.

    def decay_length(self, finger_length: float) -> float:
        """The length L for a finger of a length from pad to knuckle [m]."""
        floor = self.palm / self.fingertip
        wanted = (self.finger / self.fingertip - floor) / (1.0 - floor)
        low, high = 1e-3 * finger_length, 1e3 * finger_length
        for _ in range(80):
            middle = math.sqrt(low * high)
            mean = 2.0 * math.atan(math.tanh(0.5 * finger_length / middle)) * middle / finger_length
            low, high = (middle, high) if mean < wanted else (low, middle)
        return high

    def weights(self, distances: ArrayLike, finger_length: float) -> Real:
        """α at distances from the nearest pad [m], of the same shape; f where infinite."""
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
    """Perceptual weights of a bound hand, found once.

    Example:
        >>> skin = SkinSensitivity.of(rig)
        >>> field = PressureField.from_contacts(contacts, array.position, weights=skin.ghosts)
    """

    vertices: Real
    """Weight α of each vertex of the skin, for a color layer, shape [V]."""
    ghosts: Real
    """Weight α of each ghost, shape [G]."""
    distances: Real
    """Distance of each vertex along the skin from the nearest pad [m], shape [V]."""
    pads: FingerPads
    """The finger pads."""

    @classmethod
    def of(cls, rig: HandRig, density: ReceptorDensity | None = None) -> SkinSensitivity:
        """Find the weights for any hand whose bones are named after fingers.

        Args:
            rig: The bound hand.
            density: Densities that the weights follow, the preset's where not given.

        Raises:
            ValueError: No finger is found; the message says which names are understood.
        """
        density = density or ReceptorDensity.preset()
        pads = find_finger_pads(rig)
        distances = geodesic_distances(rig.vertices, rig.faces, pads.vertices)
        vertices = density.weights(distances, pads.finger_length)
        ghosts = _on_surface(rig.vertices, rig.faces, vertices, rig.carried_ghosts(rig.nodes))
        return cls(vertices, ghosts, distances, pads)


def _on_surface(vertices: Real, faces: NDArray[np.integer], values: Real, points: Real) -> Real:
    """Values of a surface at the places next to points, linear over triangles, shape [P].

    Triangles about the nearest vertex are tried, which finds the place where triangles are even.
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
        shares, away = _closest(
            np.repeat(part, count, axis=0), vertices[triangles].reshape(-1, 3, 3)
        )
        best = away.reshape(-1, count).argmin(1)
        rows = np.arange(len(part))
        chosen = shares.reshape(-1, count, 3)[rows, best]
        result[begin : begin + _CHUNK] = (chosen * values[triangles[rows, best]]).sum(1)
    return result


def _closest(points: Real, triangles: Real) -> tuple[Real, Real]:
    """Barycentric coordinates of the place in each triangle next to its point, and distance²."""
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
        away = np.square(start + along[:, None] * edge - points).sum(1)
        nearer = away < best
        best = np.where(nearer, away, best)
        shares[nearer] = 0.0
        shares[nearer, first] = 1.0 - along[nearer]
        shares[nearer, second] = along[nearer]
    return shares, best
