# SPDX-License-Identifier: GPL-3.0-or-later
"""The clay of the paper, as printed."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..colliders.contacts import Contacts
from ..contact.law import ContactPass
from ..core.particles import Particles
from ..core.regions import Regions
from ..scene.scene import Scene
from ..scene.settings import Settings
from .bonds import BondConstraints
from .contact import PaperContacts
from .density import DensityConstraints
from .kernel import KERNEL_RADIUS
from .neighbors import NeighborRows
from .viscosity import ViscosityConstraints

SKIN = 0.3
"""Extra reach of neighbour rows, in spacings."""


@wp.kernel(enable_backward=False)
def predict_displacement(
    time_step: float,
    velocity_free: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
) -> None:
    """Unconstrained motion: the first loop of algorithm 1."""
    i = wp.tid()
    displacement[i] = velocity_free[i] * time_step


@wp.kernel(enable_backward=False)
def update_velocity(
    time_step: float,
    displacement: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
) -> None:
    """Velocities by finite differences: the last loop of algorithm 1."""
    i = wp.tid()
    velocity[i] = displacement[i] / time_step


ITERATIONS = 4
"""Relaxation iterations in a substep, where the settings do not say."""


class PaperModel:
    """Position-based clay: density, viscosity, elastoplasticity and contact as constraints.

    Algorithm 1 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
    WHC 2021: predict, project the types of constraints one after the other and all constraints of
    a type at once, update velocities. `Settings.iterations` are its relaxation iterations,
    `Settings.substeps` its time steps in 1/60 s. Where the paper leaves a choice, the file of each
    constraint says which was made.

    Example::

        solver = Solver(scene, Settings(model="paper"))
        ablated = Solver(scene, Settings(model="paper", viscosity=False))

    *Limitations*: of a `Material` only density and friction count; the clay is as stiff as
    spacing, substeps and iterations make it. At 8 substeps of 4 iterations a cube of 4 cm leans by
    .06 of its size on an incline of 15° at a spacing of 5 mm, by .03 at 10 mm and by .27 at
    2.5 mm; at 4 substeps it gives way. Clay yields by its rate of strain, not by stress: where a
    ball was pressed in by 10 mm, .95 of the dent springs back at 15 mm/s, .7 at 50, .4 at 150 and
    .1 at 300. Velocities are differences of positions,
    which damps rotation, by 1/√(1 + 2 ω² Δt t).
    What lies deeper in a mesh than one and a half spacings is not found and not moved out.
    Particles at one point stay together: a kernel has no gradient there.

    Args:
        scene: Not used: all that counts of its materials is with the particles.
        particles: What the clay consists of.
        contacts: What it touches.
        settings: How finely to work, and which of the constraints to leave out.
    """

    def __init__(
        self, scene: Scene, particles: Particles, contacts: Contacts, settings: Settings
    ) -> None:
        self.particles = particles
        self.settings = settings
        count, spacing, device = particles.count, particles.spacing, particles.device
        self.device = device
        self.displacement = wp.zeros(count, dtype=wp.vec3, device=device)
        """Since the beginning of the substep [m]: small numbers, which float32 resolves."""
        self._spare = wp.zeros(count, dtype=wp.vec3, device=device)
        self.neighbors = NeighborRows(
            count, spacing, KERNEL_RADIUS * spacing, SKIN * spacing, device
        )
        self.density = DensityConstraints(particles)
        self.viscosity = ViscosityConstraints(particles) if settings.viscosity else None
        self.bonds = BondConstraints(particles) if settings.elastoplasticity else None
        self.contact = PaperContacts(particles, contacts)
        if count:
            self.neighbors.rebuild(particles.position)
            if self.bonds:
                self.bonds.activate_all(self.neighbors.rows)

    @property
    def can_sleep(self) -> bool:
        """All of it moves, or none of it: its passes work on all particles."""
        return False

    def rest(self, resting: NDArray, time_step: float) -> None:
        """Nothing falls asleep."""

    def unheld(self, regions: Regions) -> NDArray:
        """Nothing ever sleeps."""
        return np.zeros(len(regions.asleep), bool)

    def wake(self, woken: NDArray) -> None:
        """Nothing wakes."""

    def woken(self) -> None:
        """Nothing wakes."""

    def begin_step(self) -> None:
        """Nothing spans a step."""

    def run_substep(self, substep: ContactPass) -> None:
        """Carry out algorithm 1 once."""
        particles, time_step = self.particles, substep.time_step
        self.neighbors.begin_substep(particles.position)
        # As printed, gravity acts for the whole of every step.
        particles.fall_freely(time_step, time_step)
        wp.launch(
            predict_displacement,
            dim=particles.count,
            inputs=[time_step, particles.velocity_free, self.displacement],
            device=self.device,
        )
        self.contact.find(substep, self.displacement)
        self.density.begin_substep(time_step)
        if self.viscosity:
            self.viscosity.begin_substep(self.neighbors.support)
        if self.bonds:
            self.bonds.begin_substep(self.neighbors.rows, time_step)
        rows, support = self.neighbors.rows, self.neighbors.support
        for _iteration in range(self.settings.iterations or ITERATIONS):
            # Viscosity sees no displacement but motion only while density and distance
            # constraints have not begun to pull against each other: after them it feeds on that.
            if self.viscosity:
                self.viscosity.project(support, self.displacement, self._spare)
                self._take_corrected()
            self.density.project(support, self.displacement, self._spare)
            self._take_corrected()
            if self.bonds:
                self.bonds.project(rows, self.displacement, self._spare)
                self._take_corrected()
            self.contact.project(substep, self.displacement)
        self.contact.settle(substep, self.displacement)
        wp.launch(
            update_velocity,
            dim=particles.count,
            inputs=[time_step, self.displacement, particles.velocity],
            device=self.device,
        )
        particles.move(time_step)

    def _take_corrected(self) -> None:
        self.displacement, self._spare = self._spare, self.displacement

    def compression(self) -> NDArray:
        """Each particle's density over that at rest, less one, where positive; shape [N]."""
        return self.density.compression.numpy()

    @property
    def overflow(self) -> int:
        """Neighbours that found no room, since the beginning."""
        return self.neighbors.overflow

    def passes(self) -> list[str]:
        """What a substep consists of."""
        names = ["neighbour rows", "density"]
        if self.viscosity:
            names.append("viscosity")
        if self.bonds:
            names.append("distance constraints")
        return names

    def snapshot(self) -> dict[str, NDArray]:
        """Bonds and anchors."""
        return {
            "compression": self.compression().copy(),
            **self.neighbors.snapshot(),
            **self.contact.snapshot(),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        self.density.compression.assign(state["compression"])
        self.neighbors.restore(state)
        self.contact.restore(state)
