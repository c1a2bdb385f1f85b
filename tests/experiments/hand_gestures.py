# SPDX-License-Identifier: GPL-3.0-or-later
"""Gestures of soft fingers: a pinch that tears off a piece of clay, and a dent."""

from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.hand.rig import HandRig

from .hand_shapes import finger, posed
from .pieces import pieces
from .shapes import at, block

SPACING = 0.005


@dataclass(frozen=True)
class Pinch:
    """The clay after two fingers pinched it and moved away."""

    lifted: int
    """Number of particles lifted with the fingers."""
    stayed: int
    """Number of particles left on the table."""
    pieces: int
    """Number of pieces of more than two particles."""
    grip: float
    """Force of one finger on the other through the clay when closed [N]."""
    imbalance: float
    """Difference of the two forces, over the grip."""


def pinch(
    material: Material | None = None,
    *,
    rig: HandRig | None = None,
    hold_stiffness: float | None = None,
    settings: Settings | None = None,
) -> Pinch:
    """Pinch a ridge on a slab of clay between two fingers that point down, and pull it off.

    Args:
        material: The clay.
        rig: A finger of 8 mm radius, its tip at the origin.
        hold_stiffness: Stiffness of its hold [N/m].
        settings: Solver settings.
    """
    rig = rig or finger(0.008)
    scene = Scene(SPACING)
    slab = block((12, 12, 4), SPACING)
    ridge = block((2, 3, 6), SPACING, (0.0, 0.0, 4 * SPACING))
    clay = material or Material(yield_stress=2e3, shear_modulus=1e5, viscosity=50.0)
    scene.add_clay(np.concatenate([slab, ridge]), clay)
    scene.add_plane(friction=1.0)
    fingers = [scene.add_hand(rig, friction=1.0, hold_stiffness=hold_stiffness) for _ in range(2)]

    def put(apart: float, height: float) -> None:
        for hand, side in zip(fingers, (-1, 1), strict=True):
            hand.set_bones(posed(rig, at(side * (0.008 + apart), 0.0, height)))

    low = 4 * SPACING + 0.002
    put(0.007, low)
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(8):
        solver.step(1 / 60)
    for apart in np.linspace(0.007, 0.0015, 24):
        put(apart, low)
        solver.step(1 / 60)
    for _ in range(6):
        solver.step(1 / 60)
    left, right = (solver.force_on(hand) for hand in fingers)
    for height in np.linspace(low, low + 0.05, 40):
        put(0.0015, height)
        solver.step(1 / 60)
    heights = solver.positions()[:, 2]
    lifted = heights > 0.5 * (low + 0.05)
    sizes = [len(piece) for piece in pieces(solver.positions(), SPACING)]
    return Pinch(
        lifted=int(lifted.sum()),
        stayed=int((~lifted).sum()),
        pieces=sum(size > 2 for size in sizes),
        grip=float(-left[0]),
        imbalance=float(abs(left[0] + right[0]) / max(abs(left[0]), 1e-9)),
    )


@dataclass(frozen=True)
class Dent:
    """The dent of a pressed finger."""

    width: float
    """Width of the dent at half its depth [m]."""
    depth: float
    """Depth of the dent [m]."""
    rim: float
    """Mean rise of the clay in a surrounding ring as wide as the finger [m]."""


def dent(
    depth: float = 0.009,
    *,
    rig: HandRig | None = None,
    material: Material | None = None,
    spacing: float = 0.004,
    settings: Settings | None = None,
) -> Dent:
    """Press a finger into a block of clay, lift it, and measure the dent.

    Args:
        depth: How far the bone moves beyond first touch [m].
        rig: A finger of 8 mm radius, its tip at the origin.
        material: The clay.
        spacing: Particle spacing [m].
        settings: Solver settings.
    """
    rig = rig or finger(0.008)
    across, high = round(0.056 / spacing), round(0.032 / spacing)
    top = high * spacing
    scene = Scene(spacing)
    scene.add_clay(block((across, across, high), spacing), material or Material())
    scene.add_plane()
    hand = scene.add_hand(rig)
    hand.set_bones(posed(rig, at(0, 0, top + 0.001)))
    solver = Solver(scene, settings)
    solver.begin()
    before = solver.positions()
    for height in np.concatenate(
        [np.linspace(top + 0.001, top - depth, 24), np.full(8, top - depth)]
    ):
        hand.set_bones(posed(rig, at(0, 0, height)))
        solver.step(1 / 60)
    for height in np.linspace(top - depth, top + 0.02, 24):
        hand.set_bones(posed(rig, at(0, 0, height)))
        solver.step(1 / 60)
    surface = before[:, 2] > top - spacing
    sunk = (before - solver.positions())[surface, 2]
    away = np.hypot(before[surface, 0], before[surface, 1])
    deepest = float(np.sort(sunk)[-4:].mean())
    area = float((sunk > 0.5 * deepest).sum()) * spacing**2
    ring = (away > 0.012) & (away < 0.024)
    return Dent(
        width=2.0 * float(np.sqrt(area / np.pi)), depth=deepest, rim=float(-sunk[ring].mean())
    )
