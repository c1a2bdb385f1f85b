# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of sleeping clay that has lost its support.

To its awake neighbors, sleeping clay is a wall, and a wall holds whatever hangs on it, even after
its own support is gone. So in each step, for each piece of sleeping clay, its weight, the forces of
colliders when it fell asleep and the forces of its awake neighbors are summed: unless they balance,
the piece is unsupported. Clay that lies on something may be pressed against it, though.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..colliders.contacts import Contacts
from ..contact.law import ContactSlots
from ..core.awake import Awake, awake_particle
from ..core.particles import Particles
from ..core.regions import Regions
from .law_data import BREAK_LENGTH, PairLaw, ParticleLaw, SharedLaw
from .law_functions import bond_hold, kernel_slope, pair_pull
from .pairs.rows import COMPRESSION, PairRows

MAX_IMBALANCE = 0.2
"""Sleeping clay tolerates this fraction of its weight sideways or upward: friction and inertia hold
it."""
MIN_ACCELERATION = 0.1
"""Imbalances that would accelerate sleeping clay by less than this are ignored [m/s²]."""


@wp.kernel(enable_backward=False)
def sum_reactions(
    awake: Awake,
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    pairs: PairRows,
    region: wp.array[int],
    force: wp.array[wp.vec3],
) -> None:
    """Sum the forces of awake particles on sleeping ones, by region of the latter [N]."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    own = material[i]
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        j = pairs.other[slot]
        if pairs.resting[j] == 1:
            offset = position[i] - position[j]
            apart = wp.length(offset)
            pressures = particle_laws[own].pressure_stiffness * pairs.condition[i][COMPRESSION]
            other = particle_laws[material[j]]
            pressures += other.pressure_stiffness * pairs.condition[j][COMPRESSION]
            rest = pairs.rest_length[slot]
            stiffness = float(0.0)
            if rest > 0.0:
                law = pair_laws[own * shared.material_count + material[j]]
                stiffness = law.stiffness * bond_hold(shared, rest)
            slope = kernel_slope(shared, apart)
            pull = pair_pull(shared, 0.0, 0.0, pressures, slope, stiffness, apart - rest)
            wp.atomic_add(force, region[j], offset * (pull / wp.max(apart, 1.0e-12)))


@wp.kernel(enable_backward=False)
def sum_support(
    pairs: PairRows,
    material: wp.array[int],
    mass: wp.array[float],
    slots: ContactSlots,
    region: wp.array[int],
    support: wp.array[wp.vec3],
    region_mass: wp.array[float],
) -> None:
    """Sum the forces of colliders on sleeping particles [N] and their mass [kg], by region.

    The contact slots of sleeping particles hold forces instead of impulses.
    """
    i = wp.tid()
    if pairs.resting[i] == 1:
        wp.atomic_add(region_mass, region[i], mass[material[i]])
        if slots.count.shape[0] > 0:
            for k in range(slots.count[i]):
                wp.atomic_add(support, region[i], slots.impulse[i, k])


class Balance:
    """Finds sleeping clay that has lost its support.

    Args:
        particles: The clay.
    """

    def __init__(self, particles: Particles) -> None:
        self.particles = particles
        self._generation = -1
        self._piece = np.zeros(0, int)
        self._support = np.zeros((0, 3))
        self._mass = np.zeros(0)

    def unsupported(
        self,
        regions: Regions,
        shared: SharedLaw,
        pair_laws: wp.array,
        particle_laws: wp.array,
        pairs: PairRows,
        contacts: Contacts,
    ) -> NDArray[np.bool_]:
        """Whether each region is asleep but has lost its support, shape [R].

        Args:
            regions: The regions of the clay, asleep and awake.
            shared: Values that all pairs share.
            pair_laws: Values of each pair of materials.
            particle_laws: Values of particles of each material.
            pairs: The rows of neighbors.
            contacts: The contacts of the clay.
        """
        asleep, particles = regions.asleep, self.particles
        count, device = len(asleep), particles.device
        occupied = asleep & np.isfinite(regions.boxes[:, 0, 0])
        if not occupied.any() or asleep.all():
            return np.zeros(count, bool)
        if self._generation != regions.generation:
            # Until regions change, sleeping clay neither moves nor presses differently.
            self._generation = regions.generation
            self._piece = self._pieces(regions, occupied)
            self._sum_support(regions, pairs, contacts)
        force = wp.zeros(count, dtype=wp.vec3, device=device)
        particles.launch(
            sum_reactions,
            shared,
            pair_laws,
            particle_laws,
            particles.material,
            particles.position,
            pairs,
            regions.region,
            force,
        )
        gravity = np.array(particles.gravity)
        net = np.zeros((count, 3))
        np.add.at(net, self._piece, self._support + force.numpy())
        mass = np.bincount(self._piece, self._mass, minlength=count)
        net += mass[:, None] * gravity
        support = np.zeros((count, 3))
        np.add.at(support, self._piece, self._support)
        strength = float(np.linalg.norm(gravity))
        if strength > 0.0:
            down = gravity / strength
            into = np.maximum(net @ down, 0.0) * (support @ down < 0.0)
            net -= into[:, None] * down
        tolerated = mass * (MAX_IMBALANCE * strength + MIN_ACCELERATION)
        return occupied & (np.linalg.norm(net, axis=1) > tolerated)[self._piece]

    def _pieces(self, regions: Regions, occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Label of the connected piece of sleeping clay that each region is in, shape [R]."""
        boxes, shape = regions.boxes, regions.shape
        reach = BREAK_LENGTH * self.particles.spacing
        label = np.arange(len(occupied))
        index = label.reshape(shape)
        pairs = []
        for step in ((0, 0, 1), (0, 1, 0), (1, 0, 0), *_DIAGONALS):
            here = tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(step, shape, strict=True))
            there = tuple(slice(max(0, s), n + min(0, s)) for s, n in zip(step, shape, strict=True))
            a, b = index[here].ravel(), index[there].ravel()
            both = occupied[a] & occupied[b]
            a, b = a[both], b[both]
            close = (boxes[a, 0] < boxes[b, 1] + reach) & (boxes[b, 0] < boxes[a, 1] + reach)
            close = close.all(1)
            pairs.append(np.stack([a[close], b[close]], 1))
        edges = np.concatenate(pairs)
        while True:
            lowest = np.minimum(label[edges[:, 0]], label[edges[:, 1]])
            before = label.copy()
            np.minimum.at(label, edges[:, 0], lowest)
            np.minimum.at(label, edges[:, 1], lowest)
            label = label[label]
            if np.array_equal(label, before):
                return label

    def _sum_support(self, regions: Regions, pairs: PairRows, contacts: Contacts) -> None:
        particles, device = self.particles, self.particles.device
        support = wp.zeros(len(regions.asleep), dtype=wp.vec3, device=device)
        mass = wp.zeros(len(regions.asleep), dtype=float, device=device)
        slots = contacts.slots
        inputs = [pairs, particles.material, particles.mass, slots, regions.region, support, mass]
        wp.launch(sum_support, dim=particles.count, inputs=inputs, device=device)
        self._support, self._mass = support.numpy().astype(float), mass.numpy().astype(float)


_DIAGONALS = tuple(
    (x, y, z)
    for x in (0, 1)
    for y in (-1, 0, 1)
    for z in (-1, 0, 1)
    if abs(x) + abs(y) + abs(z) > 1 and (x > 0 or y > 0)
)
"""With the axes, one of each two opposite directions to a neighboring region."""
