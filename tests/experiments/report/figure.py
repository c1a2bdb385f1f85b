# SPDX-License-Identifier: GPL-3.0-or-later
"""What an experiment is judged by: a figure, the reference it should meet, and its error.

The error of a figure is its distance from a reference band [low, high], in the figure's own unit:
0 inside the band. Where theory gives one number the band has no width; where theories differ, as
slip-line constants or the slumps of Pashias and von Mises, the band spans them. Over the tolerance,
which is the goal set for the figure, the error becomes a pure number that can be compared between
experiments: 1 is a goal just met.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Value = Callable[[Any], float]
Reference = float | tuple[float, float] | Callable[[Any], float | tuple[float, float]]


@dataclass(frozen=True)
class Figure:
    """A figure that an experiment's result holds."""

    name: str
    """As the report calls it."""
    value: str | Value
    """The result's attribute, or what makes the figure of the result."""
    reference: Reference
    """What it should be: a number, a band, or what makes them of the result."""
    tolerance: float
    """The goal: how far from the reference is good enough, in the figure's unit, or as a part of
    the reference where `relative`."""
    unit: str = ""
    """Unit, empty for a pure number."""
    relative: bool = False
    """Whether the tolerance is a part of the reference."""

    def measure(self, result: Any) -> Measurement:
        """Judge a result."""
        value = self.value(result) if callable(self.value) else float(getattr(result, self.value))
        reference = self.reference(result) if callable(self.reference) else self.reference
        low, high = reference if isinstance(reference, tuple) else (reference, reference)
        middle = low if math.isinf(high) else 0.5 * (low + high)
        scale = abs(middle) if self.relative else 1.0
        return Measurement(self.name, self.unit, float(value), low, high, self.tolerance * scale)

    def missing(self) -> Measurement:
        """Stand in for a result that there is none of."""
        return Measurement(self.name, self.unit, math.nan, math.nan, math.nan, 1.0)


@dataclass(frozen=True)
class Measurement:
    """A figure that was measured."""

    figure: str
    """Its name."""
    unit: str
    """Its unit."""
    value: float
    """What was measured."""
    low: float
    """Lower end of the reference."""
    high: float
    """Upper end of the reference; infinite where there is none."""
    tolerance: float
    """How far from the reference is good enough, in the figure's unit."""

    @property
    def error(self) -> float:
        """Distance from the reference, in the figure's unit; infinite where nothing came out."""
        if not math.isfinite(self.value):
            return math.inf
        return max(self.low - self.value, self.value - self.high, 0.0)

    @property
    def score(self) -> float:
        """Error over tolerance: 1 is a goal just met."""
        return self.error / self.tolerance

    def reference_text(self) -> str:
        """The reference in words."""
        if math.isinf(self.high):
            return f"at least {self.low:.4g}"
        if self.low == self.high:
            return f"{self.low:.4g}"
        return f"{self.low:.4g} to {self.high:.4g}"
