# SPDX-License-Identifier: GPL-3.0-or-later
"""A soft fingertip pressed on a plate and into clay: effects of stiffness, substeps and lattice."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.soft_hand.flesh import Flesh
from tactile_clay.solver.soft_hand.rest import flesh_rest

from .hand_shapes import finger, posed
from .shapes import at, block

YOUNG_MODULUS = 5e4
_PENALTY = 1.2e8
"""Stiffness with which the plate pushes ghosts out [Pa/m]; they enter by 0.1 mm."""


def press_flat(
    depth: float,
    *,
    edge: float = 0.008,
    young_modulus: float = YOUNG_MODULUS,
    iterations: int = 60,
    rounds: int = 160,
) -> float:
    """Press a fingertip of 8 mm radius onto a rigid plate without friction.

    Ghosts in the plate are pushed out by a penalty; flesh and penalty are solved for alternately
    until they agree, without clay or time steps.

    Args:
        depth: How far the bone moves beyond first touch [m].
        edge: Cell edge of the lattice [m].
        young_modulus: Young's modulus of the flesh [Pa].
        iterations: Conjugate-gradient iterations per solve.
        rounds: Number of solves.

    Returns:
        The force [N].
    """
    rig = finger(edge)
    flesh = Flesh(
        rig,
        flesh_rest(rig),
        young_modulus=young_modulus,
        poisson_ratio=0.45,
        iterations=iterations,
        device=wp.get_device("cpu"),
    )
    corners = rig.tetrahedra[rig.ghost_tetrahedron]
    pressure = np.zeros(len(corners))
    load = wp.zeros(flesh.count, dtype=wp.vec3, device="cpu")
    stiffness = _PENALTY * young_modulus / YOUNG_MODULUS
    for _ in range(rounds):
        height = rig.carried_ghosts(flesh.data.position.numpy())[:, 2]
        pressure += 0.04 * (stiffness * np.maximum(depth - height, 0.0) - pressure)
        push = (pressure * rig.ghost_areas)[:, None] * rig.ghost_weights
        force = np.zeros((flesh.count, 3))
        np.add.at(force[:, 2], corners.ravel(), push.ravel())
        load.assign(force.astype(np.float32))
        flesh.stretch()
        flesh.stiffen()
        flesh.relax(load, 0.5)
    return float((pressure * rig.ghost_areas).sum())


@dataclass(frozen=True)
class FingerPress:
    """Forces on a finger pressed into clay."""

    force_moving: float
    """Mean over the last fifth of the motion [N]."""
    force_held: float
    """Force a third of a second later [N]."""
    tip_depth: float
    """Depth of the skin in the clay [m]."""
    unsteadiness: float
    """Standard deviation of the force over its mean in the last eight frames."""


def press_clay(
    depth: float = 0.012,
    *,
    rig: HandRig | None = None,
    young_modulus: float = YOUNG_MODULUS,
    hold_stiffness: float | None = None,
    speed: float = 0.05,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> FingerPress:
    """Press a finger into a block of 50 x 50 x 40 mm and hold it there.

    Args:
        depth: How far the bone moves beyond first touch [m].
        rig: The finger, its tip at the origin.
        young_modulus: Young's modulus of its flesh [Pa].
        hold_stiffness: Stiffness of its hold [N/m].
        speed: Speed of the press [m/s].
        spacing: Particle spacing [m].
        material: The clay.
        settings: Solver settings.
    """
    rig = rig or finger(0.008)
    across, high = round(0.05 / spacing), round(0.04 / spacing)
    top = high * spacing
    scene = Scene(spacing)
    scene.add_clay(block((across, across, high), spacing), material or Material())
    scene.add_plane()
    hand = scene.add_hand(rig, young_modulus=young_modulus, hold_stiffness=hold_stiffness)
    hand.set_bones(posed(rig, at(0, 0, top + 0.001)))
    solver = Solver(scene, settings)
    solver.begin()
    height = top + 0.001
    forces: list[float] = []
    moving = 0
    while len(forces) < moving + 20:
        if height > top - depth:
            height = max(height - speed / 60, top - depth)
            moving += 1
        hand.set_bones(posed(rig, at(0, 0, height)))
        solver.step(1 / 60)
        forces.append(float(solver.force_on(hand)[2]))
    (soft,) = solver._hands
    tip = rig.carried_vertices(soft.flesh.data.position.numpy())[:, 2].min()
    late = np.array(forces[-8:])
    last = max(moving // 5, 1)
    return FingerPress(
        force_moving=float(np.mean(forces[moving - last : moving])),
        force_held=float(late.mean()),
        tip_depth=float(top - tip),
        unsteadiness=float(late.std() / late.mean()),
    )


_FLAT_DEPTHS = (0.001, 0.002, 0.003)


def press_lines() -> list[str]:
    """Tables of forces by stiffness, lattice and substeps, in Markdown."""
    header = " | ".join(f"{1e3 * depth:.0f} mm" for depth in _FLAT_DEPTHS)
    lines = [
        "Flat press of a fingertip, force [N] by depth:",
        "",
        f"| | {header} |",
        "|---|---|---|---|",
    ]

    def row(name: str, edge: float = 0.008, young_modulus: float = YOUNG_MODULUS) -> str:
        forces = (
            press_flat(depth, edge=edge, young_modulus=young_modulus) for depth in _FLAT_DEPTHS
        )
        return f"| {name} | {' | '.join(f'{force:.3f}' for force in forces)} |"

    lines += [
        row(f"lattice of {1e3 * edge:g} mm, 50 kPa", edge=edge)
        for edge in (0.01, 0.008, 0.006, 0.005, 0.004)
    ]
    lines += [
        row(f"lattice of 8 mm, {1e-3 * modulus:g} kPa", young_modulus=modulus)
        for modulus in (1e4, 2e4, 1e5, 2e5)
    ]
    lines += [
        "",
        "Finger pressed into clay, its bone 12 mm (5 kPa) or 6 mm (20 kPa) deep:",
        "",
        "| clay | flesh | lattice | substeps | moving, N | held, N | skin, mm deep |",
        "|---|---|---|---|---|---|---|",
    ]
    stiff = Material(yield_stress=2e4, shear_modulus=5e5)
    cases = [
        (Material(), 0.012, YOUNG_MODULUS, edge, substeps)
        for edge, substeps in (
            (0.01, 4),
            (0.008, 4),
            (0.006, 4),
            (0.004, 4),
            (0.008, 2),
            (0.008, 8),
        )
    ]
    cases += [(stiff, 0.006, modulus, 0.008, 4) for modulus in (1e4, 2e4, 5e4, 1e5, 1e6)]
    for material, depth, modulus, edge, substeps in cases:
        result = press_clay(
            depth,
            rig=finger(edge),
            young_modulus=modulus,
            material=material,
            settings=Settings(substeps=substeps),
        )
        lines.append(
            f"| {1e-3 * material.yield_stress:g} kPa | {1e-3 * modulus:g} kPa | {1e3 * edge:g} mm "
            f"| {substeps} | {result.force_moving:.2f} | {result.force_held:.2f} "
            f"| {1e3 * result.tip_depth:.2f} |"
        )
    return lines


if __name__ == "__main__":
    print("\n".join(press_lines()))
