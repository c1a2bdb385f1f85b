# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of ``tactile-clay demo``, and the layout of their images.

Can be imported without Blender, so that the command line can list them.
"""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT = "kindergarten"


@dataclass(frozen=True)
class DemoScene:
    """A scene, and the image that shows it."""

    module: str
    """Module in `scenes`, with ``build(context)`` and ``FRAME_COUNT``."""
    description: str
    """What the scene shows, in a few words."""
    moments: tuple[float, ...]
    """Fractions of the animation at which the scene is rendered."""
    layout: str
    """``pairs``: frames of equal size, two per row; ``feature``: the last one large."""
    width: int
    """Width of a frame, or of the large one [pixels]."""
    samples: int
    """Samples per pixel."""
    simulation_seconds: float
    """Duration of the simulation on two cores [s]."""
    render_seconds: float
    """Duration of rendering on two cores [s]."""


SCENES = {
    "kindergarten": DemoScene(
        module="kindergarten",
        description="hands flatten, pinch, push and dent clay in six colors",
        # Hands arrive, flatten and pinch, tear, push, press; and the result.
        moments=(0.05, 0.22, 0.35, 0.72, 0.93, 1.0),
        layout="pairs",
        width=600,
        samples=16,
        simulation_seconds=20.0,
        render_seconds=75.0,
    ),
    "wheel": DemoScene(
        module="wheel",
        description="two hands throw a pot on a potter's wheel",
        # Hands arrive, center, open, widen; and the result.
        moments=(0.04, 0.22, 0.42, 0.62, 0.83, 1.0),
        layout="feature",
        width=960,
        samples=48,
        simulation_seconds=60.0,
        render_seconds=60.0,
    ),
    "incline": DemoScene(
        module="incline",
        description="four blocks fall on a slope, three of them without one part of the model",
        # They fall and hit the slope; the last moment is before one slides out of view.
        moments=(0.08, 0.13, 0.18, 0.26),
        layout="feature",
        width=960,
        samples=32,
        simulation_seconds=10.0,
        render_seconds=40.0,
    ),
    "character": DemoScene(
        module="character",
        description="tools model a bust from wax of six colors",
        moments=(0.0, 0.2, 0.5, 0.75, 1.0),
        layout="feature",
        width=960,
        samples=48,
        simulation_seconds=60.0,
        render_seconds=60.0,
    ),
}
"""Scenes by name."""
