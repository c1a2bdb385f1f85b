# SPDX-License-Identifier: GPL-3.0-or-later
"""Damping of everything but rigid motion, for each connected piece of clay.

Explicit bonds ring at long wavelengths, which pair damping hardly reaches. Once a step the part
of the velocities that is not the piece's rigid motion decays. The rigid part carries all of the
piece's linear and angular momentum, so neither changes.
"""

import math

import numpy as np
import warp as wp

DAMPING_RATE = 15.0
"""Rate at which non-rigid velocity decays [1/s]."""
RELABEL_STEPS = 6
"""Pieces are found anew after this many steps."""


@wp.kernel(enable_backward=False)
def label_self(label: wp.array[int]):
    """Begin with every particle a piece of its own."""
    i = wp.tid()
    label[i] = i


@wp.kernel(enable_backward=False)
def spread_labels(
    count: wp.array[int],
    index: wp.array2d[int],
    rest_length: wp.array2d[float],
    label: wp.array[int],
    changed: wp.array[int],
):
    """Take over the lowest label among bonded neighbours, and that label's own label."""
    i = wp.tid()
    lowest = label[i]
    for slot in range(count[i]):
        if rest_length[i, slot] > 0.0:
            lowest = wp.min(lowest, label[index[i, slot]])
    lowest = wp.min(lowest, label[lowest])
    if lowest < label[i]:
        label[i] = lowest
        changed[0] = 1


@wp.kernel(enable_backward=False)
def sum_momentum(
    label: wp.array[int],
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    piece_mass: wp.array[wp.float64],
    piece_center: wp.array[wp.vec3d],
    piece_velocity: wp.array[wp.vec3d],
):
    """Sum mass, first moment and momentum of each piece."""
    i = wp.tid()
    piece = label[i]
    m = wp.float64(mass[material[i]])
    wp.atomic_add(piece_mass, piece, m)
    wp.atomic_add(piece_center, piece, wp.vec3d(position[i]) * m)
    wp.atomic_add(piece_velocity, piece, wp.vec3d(velocity[i]) * m)


@wp.kernel(enable_backward=False)
def sum_spin(
    label: wp.array[int],
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    piece_mass: wp.array[wp.float64],
    piece_center: wp.array[wp.vec3d],
    piece_velocity: wp.array[wp.vec3d],
    piece_spin: wp.array[wp.vec3d],
    piece_inertia: wp.array[wp.mat33d],
):
    """Sum angular momentum and inertia of each piece about its centre."""
    i = wp.tid()
    piece = label[i]
    m = wp.float64(mass[material[i]])
    whole = piece_mass[piece]
    arm = wp.vec3d(position[i]) - piece_center[piece] / whole
    relative = wp.vec3d(velocity[i]) - piece_velocity[piece] / whole
    wp.atomic_add(piece_spin, piece, wp.cross(arm, relative) * m)
    inertia = (
        wp.identity(n=3, dtype=wp.float64) * wp.dot(arm, arm) - wp.outer(arm, arm)
    ) * m
    wp.atomic_add(piece_inertia, piece, inertia)


@wp.kernel(enable_backward=False)
def damp_velocity(
    keep: wp.float64,
    label: wp.array[int],
    position: wp.array[wp.vec3],
    piece_mass: wp.array[wp.float64],
    piece_center: wp.array[wp.vec3d],
    piece_velocity: wp.array[wp.vec3d],
    piece_spin: wp.array[wp.vec3d],
    piece_inertia: wp.array[wp.mat33d],
    velocity: wp.array[wp.vec3],
):
    """Move each velocity towards the rigid motion of its piece."""
    i = wp.tid()
    piece = label[i]
    whole = piece_mass[piece]
    inertia = piece_inertia[piece]
    # A piece of one or two particles has no inertia about some axis, and no spin there either.
    ridge = wp.trace(inertia) * wp.float64(1.0e-9) + whole * wp.float64(1.0e-24)
    inertia += wp.identity(n=3, dtype=wp.float64) * ridge
    turn = wp.inverse(inertia) * piece_spin[piece]
    arm = wp.vec3d(position[i]) - piece_center[piece] / whole
    rigid = piece_velocity[piece] / whole + wp.cross(turn, arm)
    velocity[i] = wp.vec3(rigid + (wp.vec3d(velocity[i]) - rigid) * keep)


class PieceDamping:
    """Finds the connected pieces and damps each towards its rigid motion.

    Args:
        particle_count: Number of particles.
        device: Warp device.
    """

    def __init__(self, particle_count: int, device: wp.Device) -> None:
        self.device = device
        self.particle_count = particle_count
        self.label = wp.zeros(particle_count, dtype=int, device=device)
        self.steps_since_labels = RELABEL_STEPS
        self._changed = wp.zeros(1, dtype=int, device=device)
        self._mass = wp.zeros(particle_count, dtype=wp.float64, device=device)
        self._center = wp.zeros(particle_count, dtype=wp.vec3d, device=device)
        self._velocity = wp.zeros(particle_count, dtype=wp.vec3d, device=device)
        self._spin = wp.zeros(particle_count, dtype=wp.vec3d, device=device)
        self._inertia = wp.zeros(particle_count, dtype=wp.mat33d, device=device)

    def find_pieces(self, neighbors) -> None:
        """Label every particle with the lowest index in its piece."""
        wp.launch(label_self, dim=self.particle_count, inputs=[self.label], device=self.device)
        while True:
            self._changed.zero_()
            for _ in range(4):
                wp.launch(
                    spread_labels,
                    dim=self.particle_count,
                    inputs=[
                        neighbors.count,
                        neighbors.index,
                        neighbors.rest_length,
                        self.label,
                        self._changed,
                    ],
                    device=self.device,
                )
            if self._changed.numpy()[0] == 0:
                break
        self.steps_since_labels = 0

    def apply(
        self,
        duration: float,
        neighbors,
        material: wp.array,
        mass: wp.array,
        position: wp.array,
        velocity: wp.array,
    ) -> None:
        """Damp the velocities for a step of ``duration`` [s]."""
        if self.steps_since_labels >= RELABEL_STEPS:
            self.find_pieces(neighbors)
        self.steps_since_labels += 1
        sums = [self._mass, self._center, self._velocity, self._spin, self._inertia]
        for array in sums:
            array.zero_()
        state = [self.label, material, mass, position, velocity]
        wp.launch(
            sum_momentum, dim=self.particle_count, inputs=[*state, *sums[:3]], device=self.device
        )
        wp.launch(sum_spin, dim=self.particle_count, inputs=[*state, *sums], device=self.device)
        wp.launch(
            damp_velocity,
            dim=self.particle_count,
            inputs=[math.exp(-DAMPING_RATE * duration), self.label, position, *sums, velocity],
            device=self.device,
        )

    def snapshot(self) -> dict[str, np.ndarray]:
        """Labels and their age."""
        return {
            "piece_label": self.label.numpy().copy(),
            "piece_age": np.array(self.steps_since_labels),
        }

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Take up the state that `snapshot` gave."""
        self.label.assign(snapshot["piece_label"])
        self.steps_since_labels = int(snapshot["piece_age"])
