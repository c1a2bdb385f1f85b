# SPDX-License-Identifier: GPL-3.0-or-later
"""Changing the brush's radius or strength by moving the mouse, as Blender's own brushes do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Adjusted = Literal["radius", "strength"]

_STRENGTH_PIXELS = 200.0
"""Mouse travel from no strength to full strength [pixels]."""
_PRECISE = 0.1
"""Share of the travel that counts while Shift is held."""
MIN_RADIUS = 1e-4
"""Smallest radius that can be chosen [m]."""


@dataclass
class Adjustment:
    """A radius or a strength while it is being chosen."""

    name: Adjusted
    """Whether the radius or the strength is being chosen."""
    start: float
    """Value at the start: the radius [m], or the strength, 0 to 1."""
    pixel: float
    """Size of a pixel where the brush is [m]."""
    x: float
    """Where the mouse was last [pixels]."""
    value: float = field(init=False)
    """Value now."""

    def __post_init__(self) -> None:
        self.value = self.start

    def move(self, x: float, *, precise: bool) -> float:
        """Change the value after the mouse has moved sideways.

        Args:
            x: Where the mouse is [pixels].
            precise: Whether its travel counts for a tenth.

        Returns:
            The new value.
        """
        moved = (x - self.x) * (_PRECISE if precise else 1.0)
        self.x = x
        if self.name == "radius":
            self.value = max(self.value + moved * self.pixel, MIN_RADIUS)
        else:
            self.value = min(max(self.value + moved / _STRENGTH_PIXELS, 0.0), 1.0)
        return self.value

    @property
    def text(self) -> str:
        """The value as shown to the user."""
        if self.name == "radius":
            return f"Radius: {self.value * 1e3:.3g} mm"
        return f"Strength: {self.value:.3f}"
