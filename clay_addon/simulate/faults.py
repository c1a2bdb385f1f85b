# SPDX-License-Identifier: GPL-3.0-or-later
"""What went wrong while a scene was simulated, told with names, frames and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...solver import Hand, MeshCollider, Plane, Solver

    Collider = Plane | MeshCollider | Hand

MAX_PENETRATION = 0.1
"""Clay that lies deeper than this in a collider is a fault, in spacings."""
GIVING_FLESH = 0.003
"""How far the flesh of a hand gives way without being seen to [m]."""
_COUNTED = ("quarantined", "overflow", "clamped")


@dataclass
class Fault:
    """When something went wrong, and how badly."""

    first: int | None
    """The first frame; None while clay is worked live, where what counts is what happens now."""
    frames: int = 0
    """Number of frames."""
    worst: float = 0.0
    """The largest value; for counts their sum."""
    worst_frame: int | None = 0
    """The frame of the largest value."""

    def where(self) -> str:
        """The frames, in words."""
        if self.first is None:
            return "just now"
        if self.frames == 1:
            return f"at frame {self.first}"
        return f"at {self.frames} frames, first at {self.first}"


@dataclass
class Faults:
    """Gathers what a solver counts and nobody would see."""

    jumps: dict[str, Fault] = field(default_factory=dict)
    """Colliders and hands that moved too far to be followed, by name."""
    penetrations: dict[str, Fault] = field(default_factory=dict)
    """Colliders and hands that clay lay in [m], by name."""
    counts: dict[str, Fault] = field(default_factory=dict)
    """What `Diagnostics` counts."""
    _before: dict[str, int] = field(default_factory=dict)

    def note(
        self, solver: Solver, names: Mapping[int, str], spacing: float, frame: int | None
    ) -> None:
        """Take down what happened in the solver's last step.

        Args:
            solver: After its step.
            names: Names of colliders and hands, by the `id` of what stands for them in the solver.
            spacing: Distance between particles [m].
            frame: The frame the step led to; None while clay is worked live.
        """
        for jumped in solver.jumped:
            _add(self.jumps, names.get(id(jumped), "The tool"), frame, 1.0)
        figures = solver.diagnostics()
        if figures.max_penetration > MAX_PENETRATION * spacing:
            for collider, depth in solver.penetrations():
                flesh = GIVING_FLESH if collider in solver.scene.hands else 0.0
                if depth > MAX_PENETRATION * spacing + flesh:
                    _add(self.penetrations, names.get(id(collider), "the tool"), frame, depth)
        for name in _COUNTED:
            now = getattr(figures, name)
            # A solver that was built again counts from 0.
            new = now - self._before.get(name, 0) if now >= self._before.get(name, 0) else now
            self._before[name] = now
            if new:
                _add(self.counts, name, frame, float(new), summed=True)

    def clear(self) -> None:
        """Forget what happened, but not what the solver had counted."""
        for table in (self.jumps, self.penetrations, self.counts):
            table.clear()

    def sentences(self) -> Iterator[str]:
        """What a person should know and do."""
        for name, fault in self.jumps.items():
            yield (
                f"{name!r} moved too far to be followed {fault.where()}: it jumped, and did not "
                "push the clay on its way. Key it slower, or raise Motion Samples (Clay > Bake)."
            )
        for name, fault in self.penetrations.items():
            yield (
                f"Clay lay up to {fault.worst * 1e3:.2g} mm inside {name!r} {fault.where()}"
                + (f", deepest at {fault.worst_frame}" if fault.frames > 1 else "")
                + ". Look whether it squeezes clay against something, "
                "key it slower, or use more substeps."
            )
        told = {
            "quarantined": "Particles were held in place {count} times because their state was "
            "not finite, {where}. Use more substeps.",
            "overflow": "{count} neighbors of particles found no room in the solver, {where}: the "
            "clay is squeezed more than it can follow. Use more substeps, or finer clay.",
            "clamped": "Clay was kept from flying off {count} times, {where}: it was pressed into "
            "itself, or something struck it. Key what touches it slower.",
        }
        for name, fault in self.counts.items():
            yield told[name].format(count=round(fault.worst), where=fault.where())


def _add(
    table: dict[str, Fault], name: str, frame: int | None, value: float, *, summed: bool = False
) -> None:
    fault = table.setdefault(name, Fault(frame, worst_frame=frame))
    fault.frames += 1
    if summed:
        fault.worst += value
    elif value > fault.worst:
        fault.worst, fault.worst_frame = value, frame
