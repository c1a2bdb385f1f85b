# SPDX-License-Identifier: GPL-3.0-or-later
"""An experiment of the report: how it is run, and what it is judged by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tactile_clay.solver import Settings

from .figure import Figure

SPACING = 0.005
"""Where an experiment is run at one spacing only [m]."""


@dataclass(frozen=True)
class Experiment:
    """An experiment with a known answer."""

    name: str
    """As the report calls it."""
    run: Callable[[Settings, float], Any]
    """Run it at a setting and a spacing [m]; gives the result that the figures are read from."""
    figures: tuple[Figure, ...]
    """What it is judged by."""
    source: str
    """Where the reference comes from."""
    swept: bool = False
    """Whether it is run over substeps and iterations too, for error against cost."""
    spacings: tuple[float, ...] = (SPACING,)
    """Spacings it is swept over [m]; the first is the one of the live figures."""
    quick: bool = False
    """Whether it is part of the quick report."""
