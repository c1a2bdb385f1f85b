# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solver tells about its own state."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Diagnostics:
    """Figures of the last step, and counts since the beginning."""

    time: float
    """Simulated time [s]."""
    particle_count: int
    """Number of clay particles."""
    awake: int
    """Particles that the last step moved."""
    substeps: int
    """Substeps of the last step."""
    volume_error: float
    """Mean compression of the clay: 0.01 is one percent too dense."""
    max_penetration: float
    """Deepest that a particle's ball lay inside a collider in the last step [m]."""
    max_speed: float
    """Speed of the fastest particle [m/s]."""
    clamped: int
    """Changes of velocity that were too large for one pass and were shortened."""
    overflow: int
    """Neighbours that found no free slot."""
    quarantined: int
    """Times a particle was held in place because its new state was not finite."""
    teleported: int
    """Times a collider jumped too far to sweep there."""

    def as_dict(self) -> dict[str, float | int]:
        """The same, for JSON."""
        return asdict(self)
