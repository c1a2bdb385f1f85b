# SPDX-License-Identifier: GPL-3.0-or-later
"""Elastoplasticity of the paper's clay: distance constraints that come and go (eq. 5).

A pair whose ends approach or part slower than one threshold is held at its distance; a
held pair that moves faster than another, higher threshold is released. Where the paper is silent:

- It gives no thresholds. They are strain rates here, relative velocity over distance: as
  velocities they would make the material change with the particles' spacing.
- The velocity is taken as a magnitude: pairs that are pushed together fast are released as well, so
  that clay also flows where it is compressed.
- The rate is that of the predicted motion, to which uniform gravity adds nothing.
- A state changes only after the rate has been past its threshold for some time: a passing shock is
  not flow, a neighbor that rushes by is not caught, and ringing does not cut everything.
- The rest length is the distance at activation: no stress is added, and pieces that touch merge.
"""

import warp as wp

from ..core.particles import Particles
from .neighbors import Rows

ACTIVATION_RATE = 1.0
"""Pairs that strain slower than this become bonded [1/s]."""
DEACTIVATION_RATE = 5.0
"""Bonds that strain faster than this are released [1/s]."""
ACTIVATION_TIME = 0.0125
"""How long a pair must have been slow [s]."""
DEACTIVATION_TIME = 0.004
"""How long a bond must have been fast [s]."""
ACTIVATION_REACH = 1.5
"""Pairs farther apart than this are never bonded, in spacings."""
DEACTIVATION_REACH = 2.0
"""Bonds longer than this are released at once, in spacings."""
RELAXATION = 1.7
"""Over-relaxation of the Jacobi iteration, relative to each particle's bound; chains diverge at
2."""


@wp.struct
class BondSwitch:
    """When bonds form and break, for one spacing and time step."""

    spacing: float
    time_step: float
    activation_rate: float
    activation_time: float
    deactivation_rate: float
    deactivation_time: float


@wp.func
def lists(rows: Rows, i: int, j: int) -> bool:
    """Whether particle ``i`` has ``j`` in its row."""
    found = bool(False)
    for slot in range(rows.count[i]):
        if rows.index[i, slot] == j:
            found = True
    return found


@wp.kernel(enable_backward=False)
def switch_bonds(
    law: BondSwitch,
    rows: Rows,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    bound: wp.array[float],
) -> None:
    """Activate slow pairs and release fast bonds; both ends decide alike from equal numbers.

    ``bound`` limits how far the bonds of a particle may move it together: no eigenvalue of
    Σ n nᵀ over its bonds is larger.
    """
    i = wp.tid()
    sum_of_axes = wp.mat33()
    for slot in range(rows.count[i]):
        j = rows.index[i, slot]
        offset = position[j] - position[i]
        distance = wp.length(offset)
        rest_length = rows.rest_length[i, slot]
        waited = rows.waited[i, slot]
        if distance > 0.0:
            axis = offset / distance
            rate = wp.abs(wp.dot(velocity[j] - velocity[i], axis)) / distance
            if rest_length > 0.0:
                waited = wp.where(rate > law.deactivation_rate, waited + law.time_step, 0.0)
                if waited > law.deactivation_time or distance > DEACTIVATION_REACH * law.spacing:
                    rest_length = 0.0
                    waited = 0.0
            else:
                close = distance < ACTIVATION_REACH * law.spacing
                slow = rate < law.activation_rate and close
                waited = wp.where(slow, waited + law.time_step, 0.0)
                # A row that overflowed may lack a pair that the other end lists.
                if slow and waited > law.activation_time and lists(rows, j, i):
                    rest_length = distance
                    waited = 0.0
            if rest_length > 0.0:
                sum_of_axes += wp.outer(axis, axis)
        rows.rest_length[i, slot] = rest_length
        rows.waited[i, slot] = waited
    bound[i] = wp.sqrt(wp.ddot(sum_of_axes, sum_of_axes))


@wp.kernel(enable_backward=False)
def project_bonds(
    rows: Rows,
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
    bound: wp.array[float],
    corrected: wp.array[wp.vec3],
) -> None:
    """Project particles by all bonds they take part in (eq. 2)."""
    i = wp.tid()
    own_mass = mass[material[i]]
    change = wp.vec3()
    for slot in range(rows.count[i]):
        rest_length = rows.rest_length[i, slot]
        if rest_length > 0.0:
            j = rows.index[i, slot]
            offset = position[j] - position[i] + (displacement[j] - displacement[i])
            distance = wp.length(offset)
            if distance > 0.0:
                other_mass = mass[material[j]]
                share = other_mass / (own_mass + other_mass)
                relaxation = RELAXATION / wp.max(wp.max(bound[i], bound[j]), RELAXATION)
                change += offset * (relaxation * share * (1.0 - rest_length / distance))
    corrected[i] = displacement[i] + change


class BondConstraints:
    """The semi-permanent distance constraints of all pairs.

    Args:
        particles: The particles that they act on.
    """

    def __init__(self, particles: Particles) -> None:
        self.particles = particles
        self._bound = wp.zeros(particles.count, dtype=float, device=particles.device)

    def _switch(self, rows: Rows, law: BondSwitch) -> None:
        particles = self.particles
        wp.launch(
            switch_bonds,
            dim=particles.count,
            inputs=[law, rows, particles.position, particles.velocity, self._bound],
            device=particles.device,
        )

    def _law(self) -> BondSwitch:
        law = BondSwitch()
        law.spacing = self.particles.spacing
        law.activation_rate = ACTIVATION_RATE
        law.deactivation_rate = DEACTIVATION_RATE
        return law

    def activate_all(self, rows: Rows) -> None:
        """Bond all pairs that are slow now, without waiting."""
        law = self._law()
        law.time_step = 1.0
        self._switch(rows, law)

    def begin_substep(self, rows: Rows, time_step: float) -> None:
        """Activate and release bonds by the rates at the start of a substep."""
        law = self._law()
        law.time_step = time_step
        # Half a substep of slack, so that rounding of the summed time does not matter.
        law.activation_time = ACTIVATION_TIME - 0.5 * time_step
        law.deactivation_time = DEACTIVATION_TIME - 0.5 * time_step
        self._switch(rows, law)

    def project(self, rows: Rows, displacement: wp.array, corrected: wp.array) -> None:
        """Solve once for all bonds.

        Args:
            rows: Neighbors and their bonds.
            displacement: Displacements since the start of the substep [m], read.
            corrected: Displacements after the projection [m], written.
        """
        particles = self.particles
        wp.launch(
            project_bonds,
            dim=particles.count,
            inputs=[
                rows,
                particles.material,
                particles.mass,
                particles.position,
                displacement,
                self._bound,
                corrected,
            ],
            device=particles.device,
        )
