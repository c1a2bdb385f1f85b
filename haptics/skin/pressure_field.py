# SPDX-License-Identifier: GPL-3.0-or-later
"""From contact forces on a hand's ghosts to the pressure that an array should let it feel.

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
"""Focal pressure for each pascal of light contact: 30 kPa of clay become 0.7 kPa."""
CEILING = 1000.0
"""Focal pressure that is approached under hard contact [Pa], about what one focus can have."""
FADE_TIME = 0.030
"""Time in which the field follows the contact [s]."""

Real = NDArray[np.float64]


class GhostContacts(Protocol):
    """What is read of a solver's contacts: ghosts of a hand, always in the same order."""

    @property
    def positions(self) -> Any:
        """Where the ghosts are [m], shape [G, 3]."""

    @property
    def normals(self) -> Any:
        """Outward unit normals, zero for ghosts inside the hand, shape [G, 3]."""

    @property
    def areas(self) -> Any:
        """Skin that each stands for [m²], zero inside, shape [G]."""

    @property
    def forces(self) -> Any:
        """Force of the clay on each [N], shape [G, 3]."""


def focal_pressure(
    contact_pressure: ArrayLike, *, gain: float = GAIN, ceiling: float = CEILING
) -> Real:
    """What an array should give for a pressure of clay: c (1 − e^{−g p / c}) [Pa].

    Focal pressures here and everywhere are peak values of the sound at full modulation. Clay
    presses with tens of kilopascals, an array with about one. The map rises throughout, by
    `gain` for the lightest touch and ever less towards `ceiling`, so that harder contact is always
    felt as harder and nothing is asked of the array that it cannot give.

    Args:
        contact_pressure: Pressure of the clay on the skin [Pa], at least 0.
        gain: Focal over contact pressure for light contact.
        ceiling: Focal pressure never exceeded [Pa].
    """
    pressure = np.asarray(contact_pressure, np.float64)
    return np.asarray(-ceiling * np.expm1(pressure * (-gain / ceiling)))


@dataclass(frozen=True, eq=False, kw_only=True)
class PressureField:
    """Target pressure p* on the skin that faces an array.

    *Limitations.* A ghost counts as facing the array by its normal alone: a finger's shadow on
    what lies behind it is not looked at. Sound that is bent or thrown back by the hand is not
    modelled anywhere.
    """

    positions: Real
    """Ghosts of the skin that face the array [m], shape [F, 3]."""
    pressures: Real
    """Focal pressure wanted at each [Pa], shape [F]."""
    weights: Real
    """Perceptual weight α of each, shape [F]."""
    contact_pressures: Real
    """Pressure of the clay on each, smoothed [Pa], shape [F]."""
    areas: Real
    """Skin that each stands for [m²], shape [F]."""
    ghosts: NDArray[np.intp]
    """Index of each among all ghosts of its hand, shape [F]."""
    dropped: int = 0
    """Ghosts left out for values that are not finite."""
    state: Real = field(default_factory=lambda: np.zeros(0))
    """Smoothed contact pressure of all ghosts [Pa], shape [G], which the next frame starts from;
    empty for a joined field."""
    smoothing: GhostSmoothing | None = None
    """Neighbors among the ghosts, found with the first frame."""

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

        The normal part of each ghost's force over its area, max(−n · f, 0) / A, is spread over
        about one ghost spacing along the skin, which keeps its integral; left out where the skin
        does not face the array; followed with a time constant of 30 ms, exactly for any time step;
        and turned into focal pressure by `focal_pressure`.

        Args:
            contacts: The ghosts of one hand. Force on ghosts inside the hand counts for the nearest
                on its surface.
            toward: Where the array is [m], shape [3].
            weights: Perceptual weight α of every ghost, shape [G]; 1 where not given.
            previous: The field of the frame before; without it the field starts at its final value.
            dt: Time since then [s].
            gain: Focal over contact pressure for light contact.
            ceiling: Focal pressure never exceeded [Pa].

        Raises:
            ValueError: Arrays do not fit each other, the ghosts are not those of `previous`, or an
                option is out of its range.
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
                raise ValueError(f"dt is {dt!r}; beside a previous field it must be at least 0.")
            if len(previous.state) != count:
                raise ValueError(
                    f"The previous field is of {len(previous.state)} ghosts, the contacts are of "
                    f"{count}: a hand that was bound again starts without a previous field."
                )
        fine = _finite_rows(positions, normals, areas[:, None], forces)
        dropped = int(count - np.count_nonzero(fine))
        if dropped:
            positions, normals, forces = (
                np.where(fine[:, None], a, 0.0) for a in (positions, normals, forces)
            )
            areas = np.where(fine, areas, 0.0)
        smoothing = previous.smoothing if previous is not None else None
        if smoothing is None:
            smoothing = GhostSmoothing(positions, normals, areas)
        pressed = smoothing.applied(_normal_pressure(positions, normals, areas, forces))
        facing = areas > 0.0
        offset = np.asarray(toward, np.float64) - positions
        facing &= np.einsum("gi,gi->g", offset, normals) > 0.0
        wanted = np.where(facing, pressed, 0.0)
        if previous is None:
            state = wanted
        else:
            assert dt is not None
            state = previous.state - (wanted - previous.state) * math.expm1(-dt / FADE_TIME)
            state = np.where(fine, state, previous.state) if dropped else state
        # Skin that has just turned away fades as what has just been let go does.
        shown = np.flatnonzero((facing | (state > 1.0)) & fine)
        return cls(
            positions=positions[shown],
            pressures=focal_pressure(state[shown], gain=gain, ceiling=ceiling),
            weights=alpha[shown],
            contact_pressures=state[shown],
            areas=areas[shown],
            ghosts=shown,
            dropped=dropped,
            state=state,
            # Neighbors found while some ghosts were missing must be found again.
            smoothing=None if dropped and previous is None else smoothing,
        )

    @classmethod
    def joined(cls, fields: Sequence[PressureField]) -> PressureField:
        """One field of several hands, for an array that serves them all.

        It cannot be the previous of another: each hand continues from its own.
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
    """Pressure on every ghost of the surface [Pa], 0 inside, shape [G]."""
    surface = areas > 0.0
    inside = np.flatnonzero(~surface)
    inside = inside[(forces[inside] != 0.0).any(1)]
    if len(inside) and surface.any():
        forces = forces.copy()
        outer = np.flatnonzero(surface)
        for ghost in inside:
            away = np.square(positions[outer] - positions[ghost]).sum(1)
            forces[outer[away.argmin()]] += forces[ghost]
    pressed = np.maximum(-np.einsum("gi,gi->g", normals, forces), 0.0)
    return np.asarray(np.where(surface, pressed, 0.0) / np.where(surface, areas, 1.0))


def _finite_rows(*arrays: Real) -> NDArray[np.bool_]:
    """Which rows hold finite values only, shape [G]."""
    # Sums are finite if all they add up is, which is nearly always, and far quicker to find out.
    if np.isfinite(sum(float(array.sum()) for array in arrays)):
        return np.ones(len(arrays[0]), bool)
    return np.logical_and.reduce([np.isfinite(array).all(1) for array in arrays])
