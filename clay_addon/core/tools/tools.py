# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools of a live session: what each one is, and how it follows the cursor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .edits import EditKind

Path = Literal["surface", "level", "anchored", "view", "pinch", "edit"]
"""How a tool follows the cursor: ``surface``: over the surface as it was when the stroke began;
``level``: over that surface, smoothed; ``anchored``: not at all; ``view``: in the plane of the
view; ``pinch``: as two fingers that close and then hold; ``edit``: without touching the clay."""


@dataclass(frozen=True)
class Tool:
    """A tool, and how it follows the cursor."""

    identifier: str
    """Name in the enumeration of the tool property."""
    number: int
    """Number that a .blend stores; never reused for another tool."""
    label: str
    """Name in the interface."""
    icon: str
    """Name of one of Blender's icons."""
    description: str
    """Tooltip."""
    path: Path
    """How it follows the cursor."""
    preset: str | None = None
    """Name of its mesh in ``presets/tools``."""
    depth: float = 1.0
    """How deep it goes at full strength and pressure [brush radii]."""
    size: float = 1.0
    """Scale of its mesh."""
    friction: float | None = None
    """Coulomb friction coefficient; the preset's if not given."""
    speed: float = 1.0
    """Speed relative to a working hand; clay is tough when it is cut fast."""
    held: bool = False
    """Whether a plate on the far side keeps the clay from being pushed away."""
    rolls: bool = False
    """Whether it rolls along the stroke instead of sliding."""
    edit: EditKind | None = None
    """The change it makes to the clay without touching it, if any."""


TOOLS = (
    Tool("NONE", 0, "Select", "RESTRICT_SELECT_OFF", "The mouse does nothing to the clay", "edit"),
    Tool("FINGER", 1, "Finger", "VIEW_PAN", "Press and smear with a finger", "surface", "finger"),
    Tool("PALM", 2, "Palm", "MOD_CLOTH", "Press wide and flat", "surface", "palm", depth=0.5),
    Tool("BALL", 3, "Ball", "SPHERE", "Dent with a ball stylus", "surface", "ball"),
    Tool(
        "ROLLING_PIN",
        4,
        "Rolling Pin",
        "MESH_CYLINDER",
        "Roll out; the pin lies across the stroke",
        "surface",
        "rolling_pin",
        depth=0.6,
        rolls=True,
    ),
    Tool(
        "PADDLE", 5, "Paddle", "MESH_PLANE", "Flatten with a plate", "surface", "paddle", depth=0.4
    ),
    Tool(
        "STAMP",
        6,
        "Stamp",
        "MOD_BUILD",
        "Press the shape of an object straight in",
        "anchored",
        "stamp",
        depth=0.8,
        size=0.5,
    ),
    Tool(
        "KNIFE",
        7,
        "Knife",
        "SNAP_EDGE",
        "Cut along the stroke, to a depth",
        "surface",
        "knife",
        depth=3.0,
        held=True,
    ),
    Tool(
        "WIRE",
        8,
        "Wire",
        "IPO_LINEAR",
        "Cut right through, along the line drawn",
        "view",
        speed=0.4,
        held=True,
    ),
    Tool(
        "LOOP", 9, "Loop", "MESH_TORUS", "Scrape clay off with a loop of ribbon", "surface", "loop"
    ),
    Tool(
        "SMOOTH",
        10,
        "Smooth",
        "MOD_SMOOTH",
        "Level bumps with a palm that keeps to the average surface",
        "level",
        "palm",
        # Hardly below the average surface, where it would press a dent of its own.
        depth=0.03,
        size=0.8,
        # Like a wet hand: one that sticks would drag the clay along.
        friction=0.05,
    ),
    Tool(
        "PINCH",
        11,
        "Pinch",
        "SNAP_MIDPOINT",
        "Close two fingers on the clay, then drag; Shift or the wheel pulls away from the surface",
        "pinch",
        "finger",
        depth=1.4,
        size=0.6,
        friction=0.8,
    ),
    Tool("ADD", 12, "Add Clay", "ADD", "Add clay; Ctrl removes it", "edit", edit="add"),
    Tool("REMOVE", 13, "Remove Clay", "REMOVE", "Remove clay; Ctrl adds it", "edit", edit="remove"),
    Tool("PAINT", 14, "Paint", "BRUSH_DATA", "Color the clay", "edit", edit="paint"),
)
"""All tools, in the order of menus."""

BY_IDENTIFIER = {tool.identifier: tool for tool in TOOLS}


def tool_items() -> list[tuple[str, str, str, str, int]]:
    """The tools as items of an enumeration property."""
    return [(t.identifier, t.label, t.description, t.icon, t.number) for t in TOOLS]
