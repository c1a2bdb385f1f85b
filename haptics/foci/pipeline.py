# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns the contact forces of each frame into focal points, with state between frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..acoustics.transducer_array import TransducerArray
from ..skin.pressure_field import PressureField
from .focal_points import Foci, focus, reconstruct


@dataclass(frozen=True, eq=False)
class TouchFrame:
    """What one frame should feel like, in world coordinates."""

    foci: Foci
    """The focal points."""
    skin: NDArray[np.float64] | None = None
    """Skin points that face the array [m], shape [F, 3]; None for a frame read from a bake."""
    wanted: NDArray[np.float64] | None = None
    """Target pressure at each skin point [Pa], shape [F]."""
    reconstructed: NDArray[np.float64] | None = None
    """Pressure that the focal points give at each skin point [Pa], shape [F]."""


class TouchPipeline:
    """Computes the pressure field and the focal points of successive frames.

    Example:
        >>> pipeline = TouchPipeline()
        >>> frame = pipeline.step([solver.contacts(hand)], array, dt=1 / 60)
        >>> client.send(frame.foci)
    """

    def __init__(self) -> None:
        self._fields: list[PressureField] = []
        self._foci: Foci | None = None

    def step(
        self,
        contacts: Sequence[Any],
        array: TransducerArray,
        *,
        weights: Sequence[ArrayLike | None] = (),
        dt: float | None = None,
        gain: float = 0.04,
        ceiling: float = 1000.0,
        count: int = 8,
    ) -> TouchFrame:
        """Compute the focal points of a frame.

        Args:
            contacts: The solver's contacts of each hand, see `PressureField.from_contacts`.
            array: The array, placed in the world.
            weights: Perceptual weights of the ghosts of each hand; None for 1.
            dt: Time since the previous frame [s]; None to start anew.
            gain: Focal pressure per contact pressure in light contact.
            ceiling: Maximum focal pressure [Pa].
            count: Maximum number of focal points.

        Raises:
            ValueError: Shapes do not match, or an option is out of range.
        """
        fields = []
        for index, contact in enumerate(contacts):
            last = self._fields[index] if dt is not None and index < len(self._fields) else None
            if last is not None and len(last.state) != len(contact.areas):
                # The hand was bound again and has new ghosts.
                last = None
            fields.append(
                PressureField.from_contacts(
                    contact,
                    array.position,
                    weights=weights[index] if index < len(weights) else None,
                    previous=last,
                    dt=dt if last is not None else None,
                    gain=gain,
                    ceiling=ceiling,
                )
            )
        self._fields = fields
        field = PressureField.joined(fields)
        self._foci = focus(
            field.positions,
            field.pressures,
            field.weights,
            count=count,
            sigma=array.wavelength,
            previous=self._foci if dt is not None else None,
            ceiling=ceiling,
        )
        return TouchFrame(
            self._foci,
            field.positions,
            field.pressures,
            reconstruct(self._foci, field.positions),
        )
