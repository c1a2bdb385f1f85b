# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures by which an experiment is judged, with their references and errors.

The error of a figure is its distance from a reference band [low, high] in the figure's unit, 0
inside the band. The band has no width if theory gives one number; if theories differ, like
slip-line constants or the slumps of Pashias and von Mises, it spans them. Divided by the tolerance,
the goal set for the figure, the error becomes a pure number that can be compared between
experiments: 1 means that the goal is just met.
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
    """A figure in an experiment's result."""

    name: str
    """Name in the report."""
    value: str | Value
    """Attribute of the result, or a function of the result."""
    reference: Reference
    """Expected value: a number, a band, or a function of the result that returns either."""
    tolerance: float
    """The goal: largest acceptable distance from the reference, in the figure's unit, or as a
    fraction of the reference if `relative`."""
    unit: str = ""
    """Unit; empty for a pure number."""
    relative: bool = False
    """Whether the tolerance is relative to the reference."""

    def measure(self, result: Any) -> Measurement:
        """Measure the figure in a result."""
        value = self.value(result) if callable(self.value) else float(getattr(result, self.value))
        reference = self.reference(result) if callable(self.reference) else self.reference
        low, high = reference if isinstance(reference, tuple) else (reference, reference)
        middle = low if math.isinf(high) else 0.5 * (low + high)
        scale = abs(middle) if self.relative else 1.0
        return Measurement(self.name, self.unit, float(value), low, high, self.tolerance * scale)

    def missing(self) -> Measurement:
        """Measurement for a missing result, with infinite error."""
        return Measurement(self.name, self.unit, math.nan, math.nan, math.nan, 1.0)


@dataclass(frozen=True)
class Measurement:
    """A measured figure."""

    figure: str
    """Name of the figure."""
    unit: str
    """Unit of the figure."""
    value: float
    """Measured value."""
    low: float
    """Lower end of the reference."""
    high: float
    """Upper end of the reference; infinite if there is none."""
    tolerance: float
    """Largest acceptable distance from the reference, in the figure's unit."""

    @property
    def error(self) -> float:
        """Distance from the reference in the figure's unit; infinite without a finite value."""
        if not math.isfinite(self.value):
            return math.inf
        return max(self.low - self.value, self.value - self.high, 0.0)

    @property
    def score(self) -> float:
        """Error over tolerance; 1 if the goal is just met."""
        return self.error / self.tolerance

    def reference_text(self) -> str:
        """The reference in words."""
        if math.isinf(self.high):
            return f"at least {self.low:.4g}"
        if self.low == self.high:
            return f"{self.low:.4g}"
        return f"{self.low:.4g} to {self.high:.4g}"
