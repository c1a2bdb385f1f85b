# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns contact forces on the ghosts of a hand into the pressure that an array should produce.

After section IV-A of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021 (equations 6 and 7), and Jang and Park, IEEE Trans. Haptics 13(1), 2020
(10.1109/TOH.2020.2966605).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .ghost_smoothing import GhostSmoothing

GAIN = 0.04
"""Focal pressure per contact pressure in light contact; with the default ceiling, 30 kPa of clay
give 0.7 kPa."""
CEILING = 1000.0
"""Focal pressure approached in hard contact [Pa], about the maximum of a single focus."""
FADE_TIME = 0.030
"""Time constant with which the field follows the contact [s]."""

Real = NDArray[np.float64]


class GhostContacts(Protocol):
    """Contacts of a hand as a solver gives them: one entry per ghost, always in the same order."""

    @property
    def positions(self) -> Any:
        """Positions of the ghosts [m], shape [G, 3]."""

    @property
    def normals(self) -> Any:
        """Outward unit normals, zero for ghosts inside the hand, shape [G, 3]."""

    @property
    def areas(self) -> Any:
        """Area of skin that each represents [m²], zero inside the hand, shape [G]."""

    @property
    def forces(self) -> Any:
        """Force of the clay on each [N], shape [G, 3]."""


def focal_pressure(
    contact_pressure: ArrayLike, *, gain: float = GAIN, ceiling: float = CEILING
) -> Real:
    """Map a contact pressure p to a focal pressure: c (1 − e^{−g p / c}) [Pa].

    Focal pressures are always peak values of the sound at full modulation. Clay presses with tens
    of kilopascals, an array with about one. The map increases everywhere, with slope `gain` for the
    lightest touch and flattening toward `ceiling`: harder contact always feels harder, and the
    array is never driven beyond what it can produce.

    Args:
        contact_pressure: Pressure of the clay on the skin [Pa], at least 0.
        gain: Focal pressure per contact pressure in light contact.
        ceiling: Upper limit of the focal pressure [Pa].
    """
    pressure = np.asarray(contact_pressure, np.float64)
    return np.asarray(-ceiling * np.expm1(pressure * (-gain / ceiling)))


@dataclass(frozen=True, eq=False, kw_only=True)
class PressureField:
    """Target pressure p* on the skin that faces an array.

    *Limitations.* Whether a ghost faces the array is decided by its normal alone, ignoring skin in
    between that shadows it. Diffraction and reflection of sound by the hand are not modeled.
    """

    positions: Real
    """Ghosts that face the array [m], shape [F, 3]."""
    pressures: Real
    """Target focal pressure at each [Pa], shape [F]."""
    weights: Real
    """Perceptual weight α of each, shape [F]."""
    contact_pressures: Real
    """Smoothed pressure of the clay on each [Pa], shape [F]."""
    areas: Real
    """Area of skin that each represents [m²], shape [F]."""
    ghosts: NDArray[np.intp]
    """Index of each among all ghosts of its hand, shape [F]."""
    dropped: int = 0
    """Number of ghosts left out because of values that are not finite."""
    state: Real = field(default_factory=lambda: np.zeros(0))
    """Smoothed contact pressure of all ghosts [Pa], shape [G], from which the next frame continues;
    empty for a joined field."""
    smoothing: GhostSmoothing | None = None
    """Smoothing kernel over the ghosts, built in the first frame."""

    @classmethod
    def from_contacts(
        cls,
        contacts: GhostContacts,
        toward: ArrayLike,
        *,
        weights: ArrayLike | None = None,
        previous: PressureField | None = None,
        dt: float | None = None,
        gain: float = GAIN,
        ceiling: float = CEILING,
    ) -> PressureField:
        """Build the field of one frame.

        The normal pressure of each ghost, max(−n · f, 0) / A, is smoothed over about one ghost
        spacing along the skin, which preserves its integral. It is set to 0 where the skin faces
        away from the array, low-pass filtered with a time constant of 30 ms (exact for any time
        step), and converted by `focal_pressure`.

        Args:
            contacts: The ghosts of one hand. The force on a ghost inside the hand is added to the
                nearest ghost on the surface.
            toward: Position of the array [m], shape [3].
            weights: Perceptual weight α of every ghost, shape [G]; 1 if None.
            previous: The field of the previous frame; None starts at the final value.
            dt: Time since the previous frame [s].
            gain: Focal pressure per contact pressure in light contact.
            ceiling: Upper limit of the focal pressure [Pa].

        Raises:
            ValueError: Shapes do not match, the ghosts are not those of `previous`, or an option is
                out of range.
        """
        positions = np.asarray(contacts.positions, np.float64)
        normals = np.asarray(contacts.normals, np.float64)
        areas = np.asarray(contacts.areas, np.float64)
        forces = np.asarray(contacts.forces, np.float64)
        count = len(areas)
        alpha = np.ones(count) if weights is None else np.asarray(weights, np.float64)
        shapes = [a.shape for a in (positions, normals, areas, forces, alpha)]
        if shapes != [(count, 3), (count, 3), (count,), (count, 3), (count,)]:
            raise ValueError(
                f"Contacts have positions, normals, areas, forces and weights of shapes {shapes}; "
                "expected (G, 3), (G, 3), (G,), (G, 3) and (G,)."
            )
        for name, value in (("gain", gain), ("ceiling", ceiling)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}; it must be a number greater than 0.")
        if previous is not None:
            if dt is None or not (math.isfinite(dt) and dt >= 0.0):
                raise ValueError(f"dt is {dt!r}; with a previous field it must be at least 0.")
            if len(previous.state) != count:
                raise ValueError(
                    f"The previous field has {len(previous.state)} ghosts, the contacts have "
                    f"{count}. After a hand is bound again, start without a previous field."
                )
        finite = _finite_rows(positions, normals, areas[:, None], forces)
        dropped = int(count - np.count_nonzero(finite))
        if dropped:
            positions, normals, forces = (
                np.where(finite[:, None], a, 0.0) for a in (positions, normals, forces)
            )
            areas = np.where(finite, areas, 0.0)
        smoothing = previous.smoothing if previous is not None else None
        if smoothing is None:
            smoothing = GhostSmoothing(positions, normals, areas)
        smooth = smoothing.smooth(_normal_pressure(positions, normals, areas, forces))
        facing = areas > 0.0
        offset = np.asarray(toward, np.float64) - positions
        facing &= np.einsum("gi,gi->g", offset, normals) > 0.0
        target = np.where(facing, smooth, 0.0)
        if previous is None:
            state = target
        else:
            assert dt is not None
            state = previous.state - (target - previous.state) * math.expm1(-dt / FADE_TIME)
            state = np.where(finite, state, previous.state) if dropped else state
        # Skin that has just turned away fades out, like contact that has just ended.
        shown = np.flatnonzero((facing | (state > 1.0)) & finite)
        return cls(
            positions=positions[shown],
            pressures=focal_pressure(state[shown], gain=gain, ceiling=ceiling),
            weights=alpha[shown],
            contact_pressures=state[shown],
            areas=areas[shown],
            ghosts=shown,
            dropped=dropped,
            state=state,
            # A kernel built while some ghosts were left out must be built again.
            smoothing=None if dropped and previous is None else smoothing,
        )

    @classmethod
    def joined(cls, fields: Sequence[PressureField]) -> PressureField:
        """Join the fields of several hands in front of the same array.

        The result cannot be used as a previous field; each hand continues from its own.
        """
        if not fields:
            nothing = np.zeros(0)
            return cls(
                positions=np.zeros((0, 3)),
                pressures=nothing,
                weights=nothing,
                contact_pressures=nothing,
                areas=nothing,
                ghosts=np.zeros(0, np.intp),
            )
        return cls(
            positions=np.concatenate([f.positions for f in fields]),
            pressures=np.concatenate([f.pressures for f in fields]),
            weights=np.concatenate([f.weights for f in fields]),
            contact_pressures=np.concatenate([f.contact_pressures for f in fields]),
            areas=np.concatenate([f.areas for f in fields]),
            ghosts=np.concatenate([f.ghosts for f in fields]),
            dropped=sum(f.dropped for f in fields),
        )


def _normal_pressure(positions: Real, normals: Real, areas: Real, forces: Real) -> Real:
    """Normal pressure on each surface ghost [Pa], 0 for ghosts inside the hand, shape [G]."""
    surface = areas > 0.0
    inside = np.flatnonzero(~surface)
    inside = inside[(forces[inside] != 0.0).any(1)]
    if len(inside) and surface.any():
        forces = forces.copy()
        outer = np.flatnonzero(surface)
        for ghost in inside:
            square = np.square(positions[outer] - positions[ghost]).sum(1)
            forces[outer[square.argmin()]] += forces[ghost]
    normal_force = np.maximum(-np.einsum("gi,gi->g", normals, forces), 0.0)
    return np.asarray(np.where(surface, normal_force, 0.0) / np.where(surface, areas, 1.0))


def _finite_rows(*arrays: Real) -> NDArray[np.bool_]:
    """Whether all values in each row are finite, shape [G]."""
    # A finite sum means that all values are finite, and is much faster than checking each.
    if np.isfinite(sum(float(array.sum()) for array in arrays)):
        return np.ones(len(arrays[0]), bool)
    return np.logical_and.reduce([np.isfinite(array).all(1) for array in arrays])
