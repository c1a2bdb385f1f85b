# SPDX-License-Identifier: GPL-3.0-or-later
"""Adjusting the brush's radius or strength by moving the mouse, as with Blender's own brushes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Adjusted = Literal["radius", "strength"]

_STRENGTH_PIXELS = 200.0
"""Mouse travel from zero to full strength [pixels]."""
_PRECISE = 0.1
"""Factor on the mouse travel while Shift is held."""
MIN_RADIUS = 1e-4
"""Minimum radius [m]."""


@dataclass
class Adjustment:
    """An ongoing adjustment of the radius or the strength."""

    name: Adjusted
    """Which of the two is being adjusted."""
    start: float
    """Initial value: the radius [m], or the strength, 0 to 1."""
    pixel: float
    """Size of a pixel at the brush [m]."""
    x: float
    """Last position of the mouse [pixels]."""
    value: float = field(init=False)
    """Current value."""

    def __post_init__(self) -> None:
        self.value = self.start

    def move(self, x: float, *, precise: bool) -> float:
        """Change the value after the mouse has moved horizontally.

        Args:
            x: Position of the mouse [pixels].
            precise: Whether to reduce the mouse travel to a tenth.

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
        """The value as text for the user."""
        if self.name == "radius":
            return f"Radius: {self.value * 1e3:.3g} mm"
        return f"Strength: {self.value:.3f}"
