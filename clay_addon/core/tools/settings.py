# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a brush at one moment, in SI units and without Blender."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .presets import ToolPreset
from .tools import BY_IDENTIFIER, Tool


@dataclass(eq=False)
class ToolMesh:
    """A closed mesh that works the clay, in its own coordinates."""

    vertices: NDArray[np.float64]
    """[m], shape [V, 3]."""
    faces: NDArray[np.int32]
    """Shape [F, 3]."""
    friction: float = 0.5
    """Coulomb friction coefficient."""


@dataclass(frozen=True, eq=False)
class BrushSettings:
    """The settings of a brush."""

    tool: Tool = BY_IDENTIFIER["FINGER"]
    """The tool in the mouse."""
    radius: float = 0.012
    """Of the brush [m]."""
    strength: float = 0.5
    """0 to 1."""
    use_pressure: bool = True
    """Whether a tablet's pressure counts."""
    mirror: tuple[bool, bool, bool] = (False, False, False)
    """Whether strokes are mirrored in X, Y, Z."""
    mirror_frame: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """World from the frame whose planes mirror [m], shape [4, 4]; rigid."""
    color: tuple[float, float, float, float] = (0.72, 0.36, 0.22, 1.0)
    """Of paint and new clay, linear RGBA."""
    spacing: float = 0.005
    """Distance between neighboring particles [m]."""
    scale: float = 1.0
    """Meters in a Blender unit."""
    stamp: ToolPreset | None = None
    """The user's own stamp; None for the default one."""
    stamp_key: str = ""
    """Tells stamps apart."""

    @property
    def speed(self) -> float:
        """Highest speed of a tool [m/s].

        It is that of a working hand, but at most two spacings in 1/60 s: in each substep, the
        solver moves a collider a quarter of a spacing along its normals.
        """
        return self.tool.speed * min(0.6, 120.0 * self.spacing)
