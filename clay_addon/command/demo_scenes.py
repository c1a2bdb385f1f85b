# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes that ``tactile-clay demo`` knows, and how their pictures are laid out.

Reads without Blender, so that the command line can list them.
"""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT = "kindergarten"


@dataclass(frozen=True)
class DemoScene:
    """A scene, and the picture that shows it."""

    module: str
    """In this package; it has ``build(context)`` and ``FRAME_COUNT``."""
    what: str
    """What is to be seen, in a few words."""
    moments: tuple[float, ...]
    """Shares of the film at which it is shown."""
    layout: str
    """``pairs``: pictures of one size, two a row; ``feature``: the last one large."""
    width: int
    """Of a picture, or of the large one [pixels]."""
    samples: int
    """A pixel."""
    simulation_seconds: float
    """How long it takes on two cores [s]."""
    render_seconds: float
    """How long it takes on two cores [s]."""


SCENES = {
    "kindergarten": DemoScene(
        module="kindergarten",
        what="hands flatten, pinch, push and dent clay in six colors",
        # Hands come, flatten and pinch, tear, push, press; and what they leave.
        moments=(0.05, 0.22, 0.35, 0.72, 0.93, 1.0),
        layout="pairs",
        width=600,
        samples=16,
        simulation_seconds=20.0,
        render_seconds=75.0,
    ),
    "wheel": DemoScene(
        module="wheel",
        what="two hands throw a pot on a potter's wheel",
        # Hands come, center, open, widen; and what they leave.
        moments=(0.04, 0.22, 0.42, 0.62, 0.83, 1.0),
        layout="feature",
        width=960,
        samples=48,
        simulation_seconds=60.0,
        render_seconds=60.0,
    ),
    "incline": DemoScene(
        module="incline",
        what="four blocks fall on a slope, each lacking something else",
        # They fall, hit the slope, and are there together before one is out of sight.
        moments=(0.08, 0.13, 0.18, 0.26),
        layout="feature",
        width=960,
        samples=32,
        simulation_seconds=10.0,
        render_seconds=40.0,
    ),
    "character": DemoScene(
        module="character",
        what="tools model a bust from wax of six colors",
        moments=(0.0, 0.2, 0.5, 0.75, 1.0),
        layout="feature",
        width=960,
        samples=48,
        simulation_seconds=60.0,
        render_seconds=60.0,
    ),
}
"""By name."""
