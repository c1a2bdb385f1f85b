# SPDX-License-Identifier: GPL-3.0-or-later
"""An experiment of the report: how it is run, and the figures by which it is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tactile_clay.solver import Settings

from .figure import Figure

SPACING = 0.005
"""Spacing of experiments that are run at only one [m]."""


@dataclass(frozen=True)
class Experiment:
    """An experiment with a known answer."""

    name: str
    """Name in the report."""
    run: Callable[[Settings, float], Any]
    """Run it at a setting and a spacing [m]; the figures are read from the result."""
    figures: tuple[Figure, ...]
    """Figures by which it is judged."""
    source: str
    """Source of the reference."""
    swept: bool = False
    """Whether it is also run over substeps and iterations, for error against cost."""
    spacings: tuple[float, ...] = (SPACING,)
    """Spacings over which it is swept [m]; the first is used for the live figures."""
    quick: bool = False
    """Whether it is part of the quick report."""
