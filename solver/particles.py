# SPDX-License-Identifier: GPL-3.0-or-later
"""The particles of a scene on the device, and how they fall and move."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .scene import Scene


@wp.kernel(enable_backward=False)
def fall_freely(
    kick: wp.vec3,
    velocity: wp.array[wp.vec3],
    velocity_free: wp.array[wp.vec3],
    quarantined: wp.array[int],
) -> None:
    """Predict velocities without any inner or contact force.

    A velocity that is not finite is taken for rest: it must not reach the others.
    """
    i = wp.tid()
    if not wp.isfinite(velocity[i]):
        velocity[i] = wp.vec3()
        wp.atomic_add(quarantined, 0, 1)
    velocity_free[i] = velocity[i] + kick


@wp.kernel(enable_backward=False)
def move(
    time_step: float,
    velocity: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    speed_limit: wp.array[float],
    clamped: wp.array[int],
    quarantined: wp.array[int],
) -> None:
    """Move particles; one whose new state is not finite stays where it is, at rest."""
    i = wp.tid()
    speed = wp.length(velocity[i])
    if speed > speed_limit[0]:
        velocity[i] = velocity[i] * (speed_limit[0] / speed)
        wp.atomic_add(clamped, 0, 1)
    moved = position[i] + velocity[i] * time_step
    if wp.isfinite(moved):
        position[i] = moved
    else:
        velocity[i] = wp.vec3()
        wp.atomic_add(quarantined, 0, 1)


class Particles:
    """What every clay model works on.

    Args:
        scene: Where particles, materials and gravity come from.
        device: Warp device.
    """

    def __init__(self, scene: Scene, device: wp.Device) -> None:
        self.device = device
        self.count = scene.particle_count
        self.spacing = scene.spacing
        self.gravity = scene.gravity
        self.materials, indices = scene.materials()
        volume = scene.spacing**3
        masses = [m.density * volume for m in self.materials]
        self.least_mass = min(masses, default=volume)
        """Of all particles [kg]."""
        self.material = wp.array(indices, dtype=int, device=device)
        """Each particle's place among the materials."""
        self.mass = wp.array(masses, dtype=float, device=device)
        """Mass of a particle of each material [kg]."""
        self.position = wp.array(scene.initial_positions(), dtype=wp.vec3, device=device)
        """[m]"""
        self.velocity = wp.array(scene.initial_velocities(), dtype=wp.vec3, device=device)
        """[m/s], at the middle of a substep."""
        self.velocity_free = wp.zeros(self.count, dtype=wp.vec3, device=device)
        """Velocities that nothing but gravity has changed in this substep [m/s]."""
        self.speed_limit = wp.zeros(1, dtype=float, device=device)
        self.clamped = wp.zeros(1, dtype=int, device=device)
        self.quarantined = wp.zeros(1, dtype=int, device=device)

    def fall_freely(self, time_step: float, time_step_before: float) -> None:
        """Set ``velocity_free``.

        Velocities are those of the middle of a substep, so gravity acts from middle to middle:
        free fall is exact whatever the substeps (leapfrog).
        """
        kick = wp.vec3(*self.gravity) * (0.5 * (time_step + time_step_before))
        wp.launch(
            fall_freely,
            dim=self.count,
            inputs=[kick, self.velocity, self.velocity_free, self.quarantined],
            device=self.device,
        )

    def move(self, time_step: float) -> None:
        """Move with the velocities, no faster than the speed limit."""
        wp.launch(
            move,
            dim=self.count,
            inputs=[
                time_step,
                self.velocity,
                self.position,
                self.speed_limit,
                self.clamped,
                self.quarantined,
            ],
            device=self.device,
        )

    def fastest(self) -> float:
        """Speed of the fastest particle [m/s]."""
        speeds = np.linalg.norm(self.velocity.numpy(), axis=1)
        return float(np.max(speeds, initial=0.0, where=np.isfinite(speeds)))

    def box(self) -> NDArray[np.float32]:
        """Lowest and highest corner of all particles [m], shape [2, 3]."""
        points = self.position.numpy()
        points = points[np.isfinite(points).all(1)]
        return np.stack([points.min(0, initial=np.inf), points.max(0, initial=-np.inf)])

    def snapshot(self) -> dict[str, NDArray]:
        """Positions, velocities and counts."""
        counts = [int(self.clamped.numpy()[0]), int(self.quarantined.numpy()[0])]
        return {
            "position": self.position.numpy().copy(),
            "velocity": self.velocity.numpy().copy(),
            "particle_faults": np.array(counts),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        self.position.assign(state["position"])
        self.velocity.assign(state["velocity"])
        clamped, quarantined = (int(n) for n in state["particle_faults"])
        self.clamped.fill_(clamped)
        self.quarantined.fill_(quarantined)
