# SPDX-License-Identifier: GPL-3.0-or-later
"""The default clay model: bonds that yield by stress, solved implicitly."""

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..colliders.contacts import Contacts
from ..contact.law import ContactPass
from ..core.particles import Particles
from ..core.recording import Recordings
from ..core.regions import Regions
from ..scene.material import Material
from ..scene.scene import Scene
from ..scene.settings import BASE_STEP, Settings
from .balance import Balance
from .cutting import cut_all_bonds
from .law_data import (
    BOND_REACH,
    PRESS_REACH,
    PairLaw,
    ParticleLaw,
    SharedLaw,
    make_pair_laws,
    make_particle_laws,
    make_shared_law,
)
from .pairs.neighbors import Neighbors
from .pairs.pairs import Pairs
from .pairs.rows import COMPRESSION
from .solve.coarse_space import CoarseSpace
from .solve.conjugate_gradients import ConjugateGradients
from .solve.spin import Spin

SKIN = 0.6
"""Extra reach of neighbor lists, in spacings."""
MAX_KEPT_LAWS = 64
"""Largest number of substep lengths for which the shared law is kept."""
ITERATIONS_PER_REACH = 0.55
"""Iterations of the last Newton step per spacing that motion travels in a substep."""
MIN_ITERATIONS = 6
MAX_ITERATIONS = 40


@wp.kernel(enable_backward=False)
def stop_particles(
    resting: wp.array[int],
    velocity: wp.array[wp.vec3],
    direction: wp.array[wp.vec4],
) -> None:
    """Stop particles, so that they contribute nothing to the passes of their awake neighbors."""
    i = resting[wp.tid()]
    velocity[i] = wp.vec3()
    direction[i] = wp.vec4()


class PlasticBonds:
    """Bonds between neighbors that stretch, yield and flow, and a pressure that keeps the volume.

    Instead of the local projections of algorithm 1 of Barreiro, Torres and Otaduy (WHC 2021), each
    substep solves for all velocities at once, by two Newton steps of conjugate gradients (Baraff
    and Witkin, *Large Steps in Cloth Simulation*, SIGGRAPH 1998, doi 10.1145/280814.280821). One
    step is not enough, since friction and yield follow from what it finds; more change little. So
    clay has its real stiffness, and weight, support and whole-body motion are exact.

    Args:
        scene: The materials of the clay.
        particles: The clay.
        contacts: The clay's contacts with colliders.
        settings: Resolution in time, and which parts of the model to use.
    """

    def __init__(
        self, scene: Scene, particles: Particles, contacts: Contacts, settings: Settings
    ) -> None:
        self.particles = particles
        self.contacts = contacts
        self.settings = settings
        count, spacing, device = particles.count, particles.spacing, particles.device
        self.device = device
        self.diagonal = wp.zeros(count, dtype=wp.mat33, device=device)
        self._materials, _ = scene.materials()
        masses = np.array([m.density * spacing**3 for m in self._materials])
        own = masses[particles.material.numpy()][:, None, None] * np.eye(3) if count else []
        self.own_block = wp.array(own, dtype=wp.mat33, device=device)
        """Mass and contact stiffness of each particle [kg]."""
        self.particle_laws = wp.array(
            make_particle_laws(self._materials, settings, spacing),
            dtype=ParticleLaw,
            device=device,
        )
        self.pairs = Pairs(particles)
        # Bonds stay listed at any length; the search need only find pairs that come close.
        self.neighbors = Neighbors(particles, self.pairs, PRESS_REACH * spacing, SKIN * spacing)
        # One extra: rounding may make a substep slightly longer.
        max_iterations = self._iterations(BASE_STEP / settings.substeps)[-1] + 1
        self.gradients = ConjugateGradients(particles, max_iterations)
        self.coarse = CoarseSpace(particles)
        self._balance = Balance(particles)
        self.spin = Spin(particles, self.coarse)
        self._recordings = Recordings(particles)
        self._shared_laws: dict[float, SharedLaw] = {}
        laws = make_pair_laws(self._materials, spacing)
        self.pair_laws = wp.array(laws, dtype=PairLaw, device=device)
        self._prepare_law(BASE_STEP / settings.substeps)
        if count:
            self.neighbors.rebuild()
            if settings.elastoplasticity:
                self.neighbors.bond_all(BOND_REACH * spacing)

    can_sleep = True

    def rest(self, resting: NDArray[np.int64], time_step: float) -> None:
        """Stop particles that fall asleep; to the others they become a wall."""
        index = wp.array(resting, dtype=int, device=self.device)
        self.contacts.rest(index, time_step)
        inputs = [
            index,
            self.particles.velocity,
            self.gradients.data.direction,
        ]
        wp.launch(stop_particles, dim=len(resting), inputs=inputs, device=self.device)
        self.coarse.release(resting)

    def unsupported(self, regions: Regions) -> NDArray[np.bool_]:
        """Whether each region is asleep but has lost its support, shape [R]."""
        return self._balance.unsupported(
            regions,
            self.shared_law,
            self.pair_laws,
            self.particle_laws,
            self.pairs.rows,
            self.contacts,
        )

    def wake(self, woken: NDArray[np.int64]) -> None:
        """Prepare particles for waking while they still count as resting."""
        index = wp.array(woken, dtype=int, device=self.device)
        self.contacts.wake(index)
        self.neighbors.match(index)

    def woken(self) -> None:
        """Find the neighbors of particles that have woken, and have new coarse cells laid out."""
        self.neighbors.rebuild()
        self.coarse.release(np.zeros(0, int))

    def begin_step(self) -> None:
        """Lay out the coarse cells over the clay, and measure their spin."""
        self.coarse.place_cells(self.neighbors.rebuild_count)
        self.spin.measure()

    def run_substep(self, substep: ContactPass) -> None:
        """Gather pairs and contacts, solve for velocities, let bonds flow, and move particles."""
        self.neighbors.rebuild_if_moved()
        self._prepare_law(substep.time_step)
        turns = self.spin.prepare(substep.time_step)
        # Generations rather than addresses: a new array may have the address of an old one.
        key = (
            substep.time_step,
            substep.time_step_before,
            self.coarse.generation,
            self.pairs.generation,
            self.particles.threads,
            self.contacts.generation,
        )
        self._recordings.run((*key, turns, "prepare"), lambda: self._prepare_solve(substep, turns))
        self.coarse.invert()
        self._recordings.run((*key, "finish"), lambda: self._finish_substep(substep))

    def _iterations(self, time_step: float) -> tuple[int, int]:
        """Iterations in each Newton step, for substeps of ``time_step`` [s].

        They grow with the distance that shear waves and viscosity carry motion in that time; beyond
        the size of a coarse cell, the coarse space carries it. The first step only finds where clay
        yields and slides: a third as many iterations suffice (measured).
        """
        last = self.settings.iterations
        if last is None:
            farthest = max((_reach(m, time_step) for m in self._materials), default=0.0)
            last = round(ITERATIONS_PER_REACH * farthest / self.particles.spacing)
            last = min(max(last, MIN_ITERATIONS), MAX_ITERATIONS)
        return -(-last // 3), last

    def _prepare_law(self, time_step: float) -> None:
        """Select the shared law of a substep; recordings refer to earlier ones."""
        if time_step not in self._shared_laws:
            if len(self._shared_laws) >= MAX_KEPT_LAWS:
                self._shared_laws.clear()
                self._recordings.clear()
            particles = self.particles
            self._shared_laws[time_step] = make_shared_law(
                self.settings, particles.spacing, len(self._materials), time_step
            )
        self.shared_law = self._shared_laws[time_step]

    def _prepare_solve(self, substep: ContactPass, turns: bool) -> None:
        """Do everything up to the coarse matrix; ``turns`` tells whether anything spins."""
        particles = self.particles
        particles.fall_freely(substep.time_step, substep.time_step_before)
        self.contacts.find(substep)
        cut_all_bonds(self.contacts, self.pairs.rows)
        if turns:
            self.spin.turn()
        self.pairs.gather(self.shared_law, self.particle_laws)
        self._linearize(substep)
        self.coarse.assemble(self.own_block, self.pairs)

    def _finish_substep(self, substep: ContactPass) -> None:
        """Solve by Newton's method, apply the velocities, and let bonds flow."""
        for newton, iterations in enumerate(self._iterations(substep.time_step)):
            if newton > 0:
                self.pairs.measure(self.shared_law, self.particle_laws)
                self._linearize(substep)
            self.gradients.solve(
                iterations,
                self.shared_law,
                self.particle_laws,
                self.pairs,
                self.diagonal,
                self.own_block,
                self.coarse,
            )
        self.contacts.settle(substep, self.gradients.change)
        self.pairs.flow(self.shared_law, self.pair_laws)
        self.particles.move(substep.time_step)
        self.neighbors.measure()

    def _linearize(self, substep: ContactPass) -> None:
        """Find residual and tangent of pairs and contacts at the current velocities."""
        residual = self.gradients.residual
        self.pairs.sum_forces(
            self.shared_law, self.pair_laws, self.particle_laws, residual, self.diagonal
        )
        self.contacts.press(substep, self.gradients.change, residual, self.diagonal, self.own_block)

    def compression(self) -> NDArray[np.float32]:
        """Relative excess of each particle's density over the rest density, at least 0; [N]."""
        return self.pairs.rows.condition.numpy()[:, COMPRESSION]

    @property
    def overflow(self) -> int:
        """Number of neighbors dropped for lack of room since the start."""
        return self.neighbors.overflow

    def passes(self) -> list[str]:
        """The passes of a substep."""
        return ["neighbor lists", "bonds" if self.settings.elastoplasticity else "pressure"]

    def snapshot(self) -> dict[str, NDArray]:
        """Bonds and their history."""
        return {
            "condition": self.pairs.rows.condition.numpy().copy(),
            **self.neighbors.snapshot(),
            **self.coarse.snapshot(),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore the state that `snapshot` returned."""
        self.pairs.rows.condition.assign(state["condition"])
        self.neighbors.restore(state)
        self.coarse.restore(state)
        # Sleeping particles must contribute nothing to any pass.
        self.gradients.data.direction.zero_()


def _reach(material: Material, time_step: float) -> float:
    """How far clay carries motion in a substep [m]."""
    wave = material.shear_modulus * time_step**2 / material.density
    return math.sqrt(wave + material.viscosity * time_step / material.density)
