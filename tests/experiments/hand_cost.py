# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of a soft hand per frame, against its number of tetrahedra."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any

import numpy as np

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.soft_hand.soft_hand import SoftHand

from .hand_shapes import posed, slab
from .shapes import at, block

EDGES = (0.016, 0.0125, 0.0095, 0.0075)
"""Cell edges of the lattices that the table compares [m]."""
LIVE_FRAME = 1e3 / 60
"""[ms]"""
_PARTS = ("plan", "begin_step", "begin_substep", "gather", "measure_compliance", "end_step")


@dataclass(frozen=True)
class HandCost:
    """Cost of a hand in a frame in which it presses clay."""

    nodes: int
    tetrahedra: int
    vertices: int
    """Number of skin vertices."""
    contacts: int
    """Number of particles in contact."""
    hand: float
    """Processor time of the hand [ms], median over frames."""
    frame: float
    """Time of the whole frame [ms]."""

    @property
    def share(self) -> float:
        """Fraction of a live frame that the hand takes."""
        return self.hand / LIVE_FRAME


class _Meter:
    """Sums the processor time spent in a hand's methods."""

    def __init__(self, soft: SoftHand) -> None:
        self.spent = 0.0
        for name in _PARTS:
            setattr(soft, name, self._timed(getattr(soft, name)))

    def _timed(self, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.thread_time()
            try:
                return method(*args, **kwargs)
            finally:
                self.spent += time.thread_time() - begin

        return timed


def measure_cost(
    rig: HandRig,
    pose: np.ndarray,
    *,
    travel: float = 0.006,
    frames: int = 40,
    hold_stiffness: float | None = None,
) -> HandCost:
    """Press a hand down onto a slab of clay of 100 x 100 x 40 mm, whose top is at z = 0.04 m.

    Args:
        rig: The hand.
        pose: Initial pose relative to the rest pose, just above the clay, shape [4, 4].
        travel: How far it moves down [m].
        frames: Number of frames; the last half is counted.
        hold_stiffness: Stiffness of its hold [N/m].
    """
    scene = Scene(0.005)
    scene.add_clay(block((20, 20, 8), 0.005), Material())
    scene.add_plane()
    hand = scene.add_hand(rig, hold_stiffness=hold_stiffness)
    hand.set_bones(posed(rig, pose))
    solver = Solver(scene)
    solver.begin()
    (soft,) = solver._hands
    meter = _Meter(soft)
    hands, whole = [], []
    for frame in range(frames):
        hand.set_bones(posed(rig, at(0, 0, -travel * (frame + 1) / frames) @ pose))
        spent, begin = meter.spent, time.perf_counter()
        solver.step(1 / 60)
        hands.append(1e3 * (meter.spent - spent))
        whole.append(1e3 * (time.perf_counter() - begin))
    return HandCost(
        nodes=len(rig.nodes),
        tetrahedra=len(rig.tetrahedra),
        vertices=len(rig.vertices),
        contacts=int(soft.forces.touched.numpy()[0]),
        hand=statistics.median(hands[frames // 2 :]),
        frame=statistics.median(whole[frames // 2 :]),
    )


def cost_table(edges: tuple[float, ...] = EDGES) -> list[HandCost]:
    """Measure downward-facing palms with ever finer lattices."""
    face_down = np.diag([1.0, -1.0, -1.0, 1.0])
    return [
        measure_cost(slab(edge, size=(0.09, 0.1, 0.03)), at(0, 0, 0.041) @ face_down)
        for edge in edges
    ]


def cost_lines() -> list[str]:
    """The table in Markdown."""
    lines = [
        "| nodes | tetrahedra | skin | contacts | hand, ms/frame | of 1/60 s | whole frame, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {cost.nodes} | {cost.tetrahedra} | {cost.vertices} | {cost.contacts} "
        f"| {cost.hand:.2f} | {cost.share:.0%} | {cost.frame:.1f} |"
        for cost in cost_table()
    ]
    return lines


if __name__ == "__main__":
    print("\n".join(cost_lines()))
