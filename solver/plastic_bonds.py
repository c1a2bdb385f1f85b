# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay as particles held by bonds that yield by stress, and a density pressure.

After the semi-permanent distance constraints of Barreiro, Torres and Otaduy, *Natural Tactile
Interaction with Virtual Clay*, WHC 2021, doi 10.1109/WHC49131.2021.9517144 (eq. 5), with these
differences: a bond is a spring of physical stiffness instead of a rigid constraint; it yields by
stress instead of by a rate of separation, so that slow hands can model it too; and it flows with
the material's viscosity, which takes the place of the strain-rate constraint (eqs. 3 and 4).
"""

import math

import numpy as np
import warp as wp

from .material import Material
from .settings import Settings

KERNEL_RADIUS = 2.0
"""Reach of the density kernel, in spacings."""
BOND_REACH = 1.5
"""Pairs closer than this at the start are bonded, in spacings."""
FORM_REACH = 1.25
"""Free pairs closer than this become bonded, in spacings."""
BREAK_LENGTH = 1.9
"""A bond longer than this is gone, in spacings."""
SHORTEST_LENGTH = 0.6
"""Rest lengths never fall below this, in spacings."""
DWELL = 2.0
"""Passes a free pair must stay close before it bonds: a neighbour rushing by is not caught."""
VOLUME_MEMORY = 0.01
"""Time in which yielding bonds forget a change of volume [s]; the pressure keeps it instead."""
YIELD_FORCE_FACTOR = 0.6
"""Yield force of a bond over τ_y d², fitted to slip-line theory of indentation."""
STIFFNESS_LIMIT = 0.2
"""Largest stable bond stiffness over m/Δt² with all pairs at once (measured)."""
PRESSURE_LIMIT = 0.12
"""Largest stable bulk modulus over ρ (d/Δt)² (measured)."""
DAMPING = 0.03
"""Damping between all close pairs, over m/Δt: takes the ringing out of explicit steps."""
BULK_OVER_SHEAR = 3.0
"""Bulk modulus over shear modulus: clay hardly compresses."""
FASTEST_KICK = 0.25
"""Largest change of velocity in one pass, in spacings a substep; more is clamped and counted."""


@wp.struct
class PairLaw:
    """How two particles of given materials act on each other, for one time step."""

    stiffness: float
    """Bond stiffness [N/m]."""
    yield_stretch: float
    """Stretch at which a bond flows [m]."""
    tension_stretch: float
    """Total stretch that a bond can carry in tension [m]."""
    flow_fraction: float
    """Part of the excess stretch that flows in one substep."""
    damping: float
    """Damping along the pair [N·s/m]."""


@wp.struct
class Body:
    """What a particle of a material has of its own, for one time step."""

    inverse_mass: float
    """[1/kg]."""
    bulk_modulus: float
    """[Pa]."""


@wp.struct
class Pass:
    """What all pairs share, for one time step."""

    spacing: float
    time_step: float
    kernel_radius: float
    inverse_rest_sum: float
    pressure_factor: float
    form_reach: float
    break_length: float
    shortest_length: float
    dwell: float
    forget_fraction: float
    fastest_kick: float
    gravity: wp.vec3
    material_count: int
    bonds: int


@wp.func
def flowed_rest_length(
    law: PairLaw, rest_length: float, distance: float, volume_stretch: float, pressed: bool,
    forget_fraction: float, shortest_length: float,
) -> float:
    """The yield law: a bond's rest length after one substep of flow [m].

    Args:
        law: The pair's values.
        rest_length: Rest length before [m].
        distance: Present distance [m].
        volume_stretch: The part of the stretch that is a change of volume [m]: it does not yield.
        pressed: Whether the pair is under pressure.
        forget_fraction: Part of the volume stretch that yielding bonds forget.
        shortest_length: Lower bound of the result [m].
    """
    stretch = distance - rest_length
    shear_stretch = stretch - volume_stretch
    excess = wp.abs(shear_stretch) - law.yield_stretch
    flow = float(0.0)
    if excess > 0.0:
        flow = wp.sign(shear_stretch) * excess * law.flow_fraction
        if volume_stretch < 0.0 or pressed:
            flow += volume_stretch * forget_fraction
    overstretch = stretch - flow - law.tension_stretch
    if overstretch > 0.0:
        flow += overstretch * law.flow_fraction
    return wp.max(rest_length + flow, shortest_length)


@wp.kernel(enable_backward=False)
def bond_pass(
    common: Pass,
    pair_laws: wp.array[PairLaw],
    bodies: wp.array[Body],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    internal: wp.array[wp.vec2],
    count: wp.array[int],
    index: wp.array2d[int],
    rest_length: wp.array2d[float],
    velocity_out: wp.array[wp.vec3],
    internal_out: wp.array[wp.vec2],
    clamped: wp.array[int],
):
    """Advance velocities by bonds, pressure and gravity, and let the bonds flow.

    ``internal`` holds the mean stretch of a particle's bonds [m] and its pressure [Pa], both of
    the pass before: that is what splits a bond's stretch into shear and change of volume.
    """
    i = wp.tid()
    x = position[i]
    v = velocity[i]
    mean_stretch = internal[i][0]
    pressure = internal[i][1]
    material_i = material[i]
    body = bodies[material_i]
    force = wp.vec3()
    kernel_sum = float(1.0)
    stretch_sum = float(0.0)
    bond_count = float(0.0)
    inverse_radius = 1.0 / common.kernel_radius
    for slot in range(count[i]):
        j = index[i, slot]
        offset = position[j] - x
        distance = wp.max(wp.length(offset), 1.0e-6 * common.spacing)
        direction = offset / distance
        other = internal[j]
        pressure_sum = pressure + other[1]
        law = pair_laws[material_i * common.material_count + material[j]]
        kernel = wp.max(1.0 - distance * inverse_radius, 0.0)
        kernel_sum += kernel * kernel * kernel
        pull = -pressure_sum * kernel * kernel * common.pressure_factor
        closing = wp.dot(velocity[j] - v, direction)
        length = rest_length[i, slot]
        if length > 0.0:
            volume_stretch = 0.5 * (mean_stretch + other[0]) * length / common.spacing
            length = flowed_rest_length(
                law, length, distance, volume_stretch, pressure_sum > 0.0,
                common.forget_fraction, common.shortest_length,
            )
            pull += law.stiffness * (distance - length) + law.damping * closing
            stretch_sum += distance - length
            bond_count += 1.0
            if wp.max(distance, length) > common.break_length:
                length = 0.0
        else:
            if distance < common.spacing:
                pull += law.damping * closing
            if common.bonds == 1 and distance < common.form_reach:
                length -= 1.0
                if length < -common.dwell:
                    length = wp.max(distance, common.shortest_length)
            else:
                length = 0.0
        rest_length[i, slot] = length
        force += direction * pull
    if bond_count > 0.0:
        mean_stretch = stretch_sum / bond_count
    else:
        mean_stretch = 0.0
    density_ratio = kernel_sum * common.inverse_rest_sum
    internal_out[i] = wp.vec2(mean_stretch, body.bulk_modulus * wp.max(density_ratio - 1.0, 0.0))
    kick = force * (body.inverse_mass * common.time_step)
    speed = wp.length(kick)
    if speed > common.fastest_kick:
        kick *= common.fastest_kick / speed
        wp.atomic_add(clamped, 0, 1)
    velocity_out[i] = v + kick + common.gravity * common.time_step


def rest_kernel_sum() -> float:
    """Sum of (1 − r/h)³ over a cubic lattice of unit spacing, the particle itself included."""
    axis = np.arange(-2, 3)
    lattice = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    distance = np.linalg.norm(lattice, axis=1)
    return float((np.maximum(1.0 - distance / KERNEL_RADIUS, 0.0) ** 3).sum())


class PlasticBonds:
    """The clay's own forces: bonds that yield, pressure, viscosity.

    Limitations: explicit, so a substep carries at most a shear modulus of about
    .2 ρ (d/Δt)² (31 kPa at a spacing of 5 mm and 32 substeps); a stiffer material is softened to
    that, and springs back more than it should. Poisson's ratio of the bonds is that of a
    central-force network; the pressure keeps the volume.

    Args:
        spacing: Particle spacing [m].
        gravity: Acceleration [m/s²].
        materials: The scene's materials, in the order of their indices.
        settings: Which parts of the model are on.
        device: Warp device.
    """

    def __init__(
        self,
        spacing: float,
        gravity: tuple[float, float, float],
        materials: list[Material],
        settings: Settings,
        device: wp.Device,
    ) -> None:
        self.spacing = spacing
        self.materials = materials
        self.settings = settings
        self.device = device
        self.clamped = wp.zeros(1, dtype=int, device=device)
        self.effective_shear_modulus = np.zeros(len(materials))
        self._bulk_modulus = np.ones(len(materials))
        self._gravity = gravity
        self._time_step = math.nan
        self._common: Pass | None = None
        self._pair_laws: wp.array | None = None
        self._bodies: wp.array | None = None

    def prepare(self, time_step: float, longest_step: float) -> None:
        """Work out the pair laws for substeps of ``time_step`` [s].

        Stiffness and damping are those that the longest substep of this solver carries, so that
        a step with more substeps does not change the material.
        """
        if time_step == self._time_step:
            return
        self._time_step = time_step
        spacing = self.spacing
        bodies = []
        shear = []
        for material in self.materials:
            carried = material.density * (spacing / longest_step) ** 2
            shear.append(min(material.shear_modulus, STIFFNESS_LIMIT * carried))
            body = Body()
            body.inverse_mass = 1.0 / (material.density * spacing**3)
            body.bulk_modulus = min(
                BULK_OVER_SHEAR * material.shear_modulus, PRESSURE_LIMIT * carried
            )
            bodies.append(body)
        self._bulk_modulus = np.array([body.bulk_modulus for body in bodies])
        self.effective_shear_modulus = np.array(shear)
        count = len(self.materials)
        laws = [self._pair_law(a, b, longest_step) for a in range(count) for b in range(count)]
        self._bodies = wp.array(bodies, dtype=Body, device=self.device)
        self._pair_laws = wp.array(laws, dtype=PairLaw, device=self.device)
        common = Pass()
        common.spacing = spacing
        common.time_step = time_step
        common.kernel_radius = KERNEL_RADIUS * spacing
        common.inverse_rest_sum = 1.0 / rest_kernel_sum()
        common.pressure_factor = 3.0 * spacing**3 / (common.kernel_radius * rest_kernel_sum())
        common.form_reach = FORM_REACH * spacing
        common.break_length = BREAK_LENGTH * spacing
        common.shortest_length = SHORTEST_LENGTH * spacing
        common.dwell = DWELL
        common.forget_fraction = time_step / (time_step + VOLUME_MEMORY)
        common.fastest_kick = FASTEST_KICK * spacing / time_step
        common.gravity = wp.vec3(*self._gravity)
        common.material_count = len(self.materials)
        common.bonds = int(self.settings.elastoplasticity)
        self._common = common

    def _pair_law(self, a: int, b: int, longest_step: float) -> PairLaw:
        """The weaker of two materials decides where their bond yields."""
        one, two = self.materials[a], self.materials[b]
        time_step, spacing = self._time_step, self.spacing
        shear = self.effective_shear_modulus
        law = PairLaw()
        law.stiffness = float(2.0 * shear[a] * shear[b] / (shear[a] + shear[b])) * spacing
        yield_force = YIELD_FORCE_FACTOR * min(one.yield_stress, two.yield_stress) * spacing**2
        tension_force = YIELD_FORCE_FACTOR * min(one.tension_limit, two.tension_limit) * spacing**2
        viscosity = 0.5 * (one.viscosity + two.viscosity) if self.settings.viscosity else 0.0
        law.yield_stretch = yield_force / law.stiffness
        law.tension_stretch = tension_force / law.stiffness
        law.flow_fraction = time_step / (time_step + viscosity * spacing / law.stiffness)
        lighter = min(one.density, two.density) * spacing**3
        law.damping = DAMPING * lighter / longest_step if self.settings.viscosity else 0.0
        return law

    def bulk_modulus(self, material: np.ndarray) -> np.ndarray:
        """Bulk modulus of particles of the given material indices [Pa]."""
        return self._bulk_modulus[material]

    def launch(
        self,
        material: wp.array,
        position: wp.array,
        velocity: wp.array,
        internal: wp.array,
        neighbors,
        velocity_out: wp.array,
        internal_out: wp.array,
    ) -> None:
        """Run one pass over all particles."""
        wp.launch(
            bond_pass,
            dim=len(position),
            inputs=[
                self._common,
                self._pair_laws,
                self._bodies,
                material,
                position,
                velocity,
                internal,
                neighbors.count,
                neighbors.index,
                neighbors.rest_length,
                velocity_out,
                internal_out,
                self.clamped,
            ],
            device=self.device,
        )
