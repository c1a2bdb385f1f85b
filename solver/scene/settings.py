# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the solver: resolution, and which parts of the model it uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

BASE_STEP = 1.0 / 60.0
"""The step that `Settings.substeps` divides [s]."""
MODELS = ("plastic_bonds", "paper")
"""Clay models: the default, and the paper's as printed."""
DEFAULT_SUBSTEPS = {"plastic_bonds": 4, "paper": 8}
"""Substeps that clay needs to look and feel right in live use. The stiffness of the paper's
distance constraints depends on substeps and iterations: with fewer, a block of 4 cm sags under its
weight."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Resolution and parts of the model; the defaults are the live setting.

    Raises:
        ValueError: A value is out of range; the message names it and the range.
    """

    substeps: int = cast(int, None)
    """Substeps per 1/60 s; longer steps, fast tools and fast clay get more. By default those of
    `DEFAULT_SUBSTEPS`."""
    iterations: int | None = None
    """Conjugate-gradient iterations in the second of a substep's two Newton steps, with a third as
    many in the first; by default as many as the clay's stiffness requires. For the model "paper",
    relaxation iterations; by default 4."""
    model: str = "plastic_bonds"
    """The clay model, one of `MODELS`."""
    viscosity: bool = True
    """Resist flow with the material's viscosity; turned off for ablation."""
    elastoplasticity: bool = True
    """Hold the shape by bonds that yield; if off, the clay is a fluid."""
    friction: bool = True
    """Coulomb friction on colliders; if off, everything slides."""
    sleeping: bool = True
    """Let clay that has come to rest sleep until something disturbs it."""

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(
                f"Settings.model is {self.model!r}; it must be one of {', '.join(MODELS)}."
            )
        if self.substeps is None:
            object.__setattr__(self, "substeps", DEFAULT_SUBSTEPS[self.model])
        if not 1 <= self.substeps <= 4096:
            raise ValueError(f"Settings.substeps is {self.substeps}; it must be from 1 to 4096.")
        if self.iterations is not None and not 1 <= self.iterations <= 1000:
            raise ValueError(
                f"Settings.iterations is {self.iterations}; it must be from 1 to 1000."
            )


QUALITIES = {
    "draft": Settings(substeps=2, iterations=4),
    "live": Settings(),
    "film": Settings(substeps=16),
}
"""The coarsest useful settings, those for live sculpting, and the finest in the report, for
rendering."""
