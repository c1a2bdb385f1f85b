# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solver reports about its own state."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Diagnostics:
    """Measurements of the last step, and counts since the start."""

    time: float
    """Simulated time [s]."""
    particle_count: int
    """Number of clay particles."""
    awake: int
    """Number of awake particles, which the last step moved."""
    substeps: int
    """Substeps of the last step."""
    volume_error: float
    """Mean compression of the clay: 0.01 means one percent too dense."""
    max_penetration: float
    """Deepest penetration of a particle into a collider in the last step [m]."""
    max_speed: float
    """Speed of the fastest particle [m/s]."""
    clamped: int
    """Number of times a particle was slowed to the speed limit."""
    overflow: int
    """Number of neighbors dropped for lack of a free slot."""
    quarantined: int
    """Number of times a particle was held in place because its new state was not finite."""
    teleported: int
    """Number of times a collider jumped because it moved too far to be swept."""

    def as_dict(self) -> dict[str, float | int]:
        """All values as a dictionary, for JSON."""
        return asdict(self)
