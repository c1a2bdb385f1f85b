# SPDX-License-Identifier: GPL-3.0-or-later
"""Viscosity of the paper's clay: the strain rate is constrained to zero (eqs. 3 and 4).

Where the paper is silent:

- Kernel gradients are corrected to be exact for linear fields (Bonet and Lok, 1999,
  doi 10.1016/S0045-7825(99)00051-1). Without that a rigidly turning block strains at its surface,
  and each projection costs angular momentum. They are computed at the start of the substep.
- The rotational part x^r of a displacement is read as the rotation of the particle's own
  neighborhood, the rotation in the polar decomposition F = R U of the deformation in the substep;
  with v = (x - x^r) / Δt eq. 3 becomes S = 2 (U - I) = 0, which holds for every rigid motion.
- The six rows of S share one denominator, eq. 2's for the whole matrix: solving rows one by one
  or as a 6 x 6 block gains nothing under Jacobi iteration.
"""

import warp as wp

from ..core.particles import Particles
from .neighbors import Support

RELAXATION = 1.2
"""Over-relaxation of the Jacobi iteration; it diverges above 1.48 on a lattice."""
MIN_EIGENVALUE = 0.15
"""Directions in which a particle has less than this fraction of its full support are ignored."""
POLAR_ITERATIONS = 2
"""Newton steps to the rotation, from the identity; a substep turns clay by a small angle."""


@wp.func
def correction_matrix(moment: wp.mat33) -> wp.mat33:
    """Pseudo-inverse of a symmetric matrix, without directions of small eigenvalues."""
    axes, eigenvalues = wp.eig3(moment)
    inverse = wp.mat33()
    for k in range(3):
        if eigenvalues[k] > MIN_EIGENVALUE:
            axis = wp.vec3(axes[0, k], axes[1, k], axes[2, k])
            inverse += wp.outer(axis, axis) / eigenvalues[k]
    return inverse


@wp.func
def rotation_of(deformation: wp.mat33) -> wp.mat33:
    """Rotation in the polar decomposition of a deformation, which may be of deficient rank.

    Newton's method for the rotation R that maximizes the trace of RᵀF; R does not turn about axes
    that F does not determine.
    """
    rotation = wp.identity(n=3, dtype=float)
    for _step in range(POLAR_ITERATIONS):
        left = wp.transpose(rotation) * deformation
        twist = wp.vec3(left[2, 1] - left[1, 2], left[0, 2] - left[2, 0], left[1, 0] - left[0, 1])
        bend = wp.identity(n=3, dtype=float) * (wp.trace(left) + 1.0e-3)
        bend -= (left + wp.transpose(left)) * 0.5
        turn = wp.inverse(bend) * twist
        angle = wp.length(turn)
        if angle > 1.0e-9:
            step = wp.quat_from_axis_angle(turn / angle, wp.min(angle, 1.0))
            rotation = rotation * wp.quat_to_matrix(step)
    return rotation


@wp.kernel(enable_backward=False)
def prepare_viscosity(
    support: Support,
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    correction: wp.array[wp.mat33],
    known: wp.array[wp.mat33],
    denominator: wp.array[float],
) -> None:
    """Find the gradient correction and eq. 2's denominator at the start of the substep.

    ``known`` projects onto the directions in which a particle has enough neighbors.
    """
    i = wp.tid()
    moment = wp.mat33()
    for slot in range(support.count[i]):
        offset = position[support.index[i, slot]] - position[i]
        moment += wp.outer(offset, support.gradient[i, slot])
    inverse = correction_matrix(moment)
    squares = float(0.0)
    total = wp.vec3()
    for slot in range(support.count[i]):
        j = support.index[i, slot]
        gradient = inverse * support.gradient[i, slot]
        squares += wp.length_sq(gradient) / mass[material[j]]
        total += gradient
    correction[i] = inverse
    known[i] = inverse * moment
    denominator[i] = 8.0 * (squares + wp.length_sq(total) / mass[material[i]])


@wp.kernel(enable_backward=False)
def solve_viscosity(
    support: Support,
    displacement: wp.array[wp.vec3],
    correction: wp.array[wp.mat33],
    known: wp.array[wp.mat33],
    denominator: wp.array[float],
    multiplier: wp.array[wp.mat33],
) -> None:
    """Find each neighborhood's strain in this substep, and the multiplier that would undo it.

    The multiplier is rotated back into the world and includes the gradient correction.
    """
    i = wp.tid()
    gradient = wp.mat33()
    for slot in range(support.count[i]):
        j = support.index[i, slot]
        gradient += wp.outer(displacement[j] - displacement[i], support.gradient[i, slot])
    deformation = known[i] + gradient * correction[i]
    found = wp.mat33()
    if denominator[i] > 0.0:
        rotation = rotation_of(deformation)
        stretch = wp.transpose(rotation) * deformation
        strain = stretch + wp.transpose(stretch) - (known[i] + wp.transpose(known[i]))
        found = rotation * strain * correction[i] * (-RELAXATION / denominator[i])
    multiplier[i] = found


@wp.kernel(enable_backward=False)
def apply_viscosity(
    support: Support,
    material: wp.array[int],
    mass: wp.array[float],
    displacement: wp.array[wp.vec3],
    multiplier: wp.array[wp.mat33],
    corrected: wp.array[wp.vec3],
) -> None:
    """Project particles by all viscosity constraints they take part in (eq. 2)."""
    i = wp.tid()
    change = wp.vec3()
    for slot in range(support.count[i]):
        j = support.index[i, slot]
        change += (multiplier[i] + multiplier[j]) * support.gradient[i, slot]
    corrected[i] = displacement[i] - change * (2.0 / mass[material[i]])


class ViscosityConstraints:
    """The viscosity constraints of all particles.

    Args:
        particles: The particles that they act on.
    """

    def __init__(self, particles: Particles) -> None:
        self.particles = particles
        count, device = particles.count, particles.device
        self._correction = wp.zeros(count, dtype=wp.mat33, device=device)
        self._known = wp.zeros(count, dtype=wp.mat33, device=device)
        self._denominator = wp.zeros(count, dtype=float, device=device)
        self._multiplier = wp.zeros(count, dtype=wp.mat33, device=device)

    def begin_substep(self, support: Support) -> None:
        """Correct gradients for the positions at the start of a substep."""
        particles = self.particles
        wp.launch(
            prepare_viscosity,
            dim=particles.count,
            inputs=[
                support,
                particles.material,
                particles.mass,
                particles.position,
                self._correction,
                self._known,
                self._denominator,
            ],
            device=particles.device,
        )

    def project(self, support: Support, displacement: wp.array, corrected: wp.array) -> None:
        """Solve once for all strain rates.

        Args:
            support: Neighbors within the kernel.
            displacement: Displacements since the start of the substep [m], read.
            corrected: Displacements after the projection [m], written.
        """
        particles = self.particles
        wp.launch(
            solve_viscosity,
            dim=particles.count,
            inputs=[
                support,
                displacement,
                self._correction,
                self._known,
                self._denominator,
                self._multiplier,
            ],
            device=particles.device,
        )
        wp.launch(
            apply_viscosity,
            dim=particles.count,
            inputs=[
                support,
                particles.material,
                particles.mass,
                displacement,
                self._multiplier,
                corrected,
            ],
            device=particles.device,
        )
