# SPDX-License-Identifier: GPL-3.0-or-later
"""The clay model of the paper, as printed."""

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
"""Extra reach of neighbor rows, in spacings."""


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
"""Relaxation iterations in a substep if the settings do not specify them."""


class PaperModel:
    """Position-based clay: density, viscosity, elastoplasticity and contact as constraints.

    Algorithm 1 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*, WHC
    2021: predict, project one type of constraint after another and all constraints of a type at
    once, update velocities. `Settings.iterations` are its relaxation iterations,
    `Settings.substeps` its time steps in 1/60 s. Where the paper leaves a choice, the module of
    each constraint documents the one made here.

    Example::

        solver = Solver(scene, Settings(model="paper"))
        ablated = Solver(scene, Settings(model="paper", viscosity=False))

    *Limitations*: only density and friction of a `Material` have an effect; the stiffness depends
    on spacing, substeps and iterations. With 8 substeps of 4 iterations, a 4 cm cube on an incline
    of 15° leans by .06 of its size at a spacing of 5 mm, by .03 at 10 mm and by .27 at 2.5 mm; with
    4 substeps it collapses. Clay yields by strain rate, not by stress: if a ball is pressed in by
    10 mm, .95 of the dent springs back at 15 mm/s, .7 at 50, .4 at 150 and .1 at 300.
    Velocities are differences of positions, which damps rotation, by 1/√(1 + 2 ω² Δt t). Particles
    deeper in a mesh than 1.5 spacings are not found and not moved out. Particles at the
    same point stay together: the kernel has no gradient there.

    Args:
        scene: Not used: the particles hold all that is needed.
        particles: The clay.
        contacts: The colliders.
        settings: Resolution in time, and which constraints to use.
    """

    def __init__(
        self, scene: Scene, particles: Particles, contacts: Contacts, settings: Settings
    ) -> None:
        self.particles = particles
        self.settings = settings
        count, spacing, device = particles.count, particles.spacing, particles.device
        self.device = device
        self.displacement = wp.zeros(count, dtype=wp.vec3, device=device)
        """Displacements since the start of the substep [m], small enough for float32 to resolve."""
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
        """Always false: the passes work on all particles."""
        return False

    def rest(self, resting: NDArray, time_step: float) -> None:
        """Do nothing: nothing falls asleep."""

    def unsupported(self, regions: Regions) -> NDArray:
        """Return false for all regions: nothing sleeps."""
        return np.zeros(len(regions.asleep), bool)

    def wake(self, woken: NDArray) -> None:
        """Do nothing: nothing sleeps."""

    def woken(self) -> None:
        """Do nothing: nothing sleeps."""

    def begin_step(self) -> None:
        """Do nothing: no state spans a step."""

    def run_substep(self, substep: ContactPass) -> None:
        """Carry out algorithm 1 once."""
        particles, time_step = self.particles, substep.time_step
        self.neighbors.begin_substep(particles.position)
        # As printed in the paper, gravity acts during the whole step.
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
            # Viscosity comes first, while displacements are motion only: after density and distance
            # constraints it would act on their pull against each other.
            if self.viscosity:
                self.viscosity.project(support, self.displacement, self._spare)
                self._swap_displacements()
            self.density.project(support, self.displacement, self._spare)
            self._swap_displacements()
            if self.bonds:
                self.bonds.project(rows, self.displacement, self._spare)
                self._swap_displacements()
            self.contact.project(substep, self.displacement)
        self.contact.settle(substep, self.displacement)
        wp.launch(
            update_velocity,
            dim=particles.count,
            inputs=[time_step, self.displacement, particles.velocity],
            device=self.device,
        )
        particles.move(time_step)

    def _swap_displacements(self) -> None:
        self.displacement, self._spare = self._spare, self.displacement

    def compression(self) -> NDArray:
        """Relative excess of each particle's density over the rest density, at least 0; [N]."""
        return self.density.compression.numpy()

    @property
    def overflow(self) -> int:
        """Number of neighbors dropped for lack of a free slot since the start."""
        return self.neighbors.overflow

    def passes(self) -> list[str]:
        """Names of the passes of a substep."""
        names = ["neighbor rows", "density"]
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
        """Restore a state returned by `snapshot`."""
        self.density.compression.assign(state["compression"])
        self.neighbors.restore(state)
        self.contact.restore(state)
