# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact and Coulomb friction between clay particles and planes or moving closed meshes.

A particle is a ball whose radius is half the spacing. Contacts are found once per substep and then
stay fixed, each as a plane; how hard they push is part of the implicit solve. Friction holds a
contact by an anchor (Barreiro, Torres and Otaduy, WHC 2021, section III-D; Yamane and Nakamura,
ICRA 2006): a spring that slides where its force would exceed μ times the normal force. Particles
inside a collider are moved out no faster than `DEPENETRATION_SPEED`.

A collider may be sticky, as a wheel head is to wet clay: a particle that has touched it stays in
contact up to a distance of `MARGIN`, and is pulled back by at most the adhesion. Adhesion adds to
friction as a load does (Derjaguin, Muller and Toporov, J. Colloid Interface Sci. 53,
1975).

The soft surface of a hand yields to pressure, but later and in a separate solve. In a contact with
it, the surface is a spring in series with the clay's. The far end of that spring is where the
surface would be without the contact force: its current position, less what it has yielded so far.
"""

import warp as wp

from ..core.awake import Awake, awake_particle

DEPENETRATION_SPEED = 0.5
"""Largest speed at which particles inside a collider are moved out [m/s]."""
MAX_CONTACTS = 4
"""Largest number of contacts of a particle."""
MARGIN = 0.25
"""Distance from the surface at which contacts are found, in spacings: a substep may close it."""
CONTACT_STIFFNESS = 2.0
"""Stiffness of a contact, relative to that of the clay around the particle."""
SOFT_DEPTH = 1.0
"""Depth beyond which soft surfaces push as if they were rigid, in particle radii."""
STICKING = 1.0e-3
"""Smallest load of a sticking contact, as a share of its adhesion."""
UNKNOWN_SLIDE = 1.0e9
"""Bound on the assumed slip of a new contact, effectively none [m]."""


@wp.struct
class ContactPass:
    """Parameters of a substep that all contacts share."""

    time_step: float
    time_step_before: float
    radius: float
    """Radius of a particle [m]."""
    margin: float
    """Distance at which contacts are found [m]."""
    yielding: wp.vec2
    """How far flesh and joints move towards equilibrium in this substep, as fractions."""


@wp.struct
class ContactSlots:
    """Contacts of all particles, `MAX_CONTACTS` for each."""

    count: wp.array[int]
    collider: wp.array2d[int]
    normal: wp.array2d[wp.vec3]
    gap: wp.array2d[float]
    """Distance between ball and surface at the start of the substep [m]."""
    surface_motion: wp.array2d[wp.vec3]
    """Motion of the surface in this substep [m]."""
    anchor: wp.array2d[wp.vec3]
    """Stretch of the friction spring [m]."""
    impulse: wp.array2d[wp.vec3]
    """Impulse on the particle at the velocities of the last evaluation [N s]."""
    normal_stiffness: wp.array2d[float]
    """[kg]: force derivative times Δt²."""
    friction_stiffness: wp.array2d[float]
    """[kg]; smaller than the normal stiffness if the contact slides."""
    stick_stiffness: wp.array2d[float]
    """The friction stiffness of a contact that does not slide [kg]."""
    count_before: wp.array[int]
    collider_before: wp.array2d[int]
    anchor_before: wp.array2d[wp.vec3]
    slide: wp.array2d[float]
    """Largest slip that the first linearization assumes [m]: that of the previous substep. Clay on
    a turning wheel still has the velocity of that substep, which would look like slip."""
    slide_before: wp.array2d[float]
    push: wp.array2d[float]
    """Normal impulse of the last solve plus that of adhesion [N s], which limits friction."""
    push_before: wp.array2d[float]
    adhesion: wp.array[float]
    """Force with which each collider pulls on a particle that sticks to it [N]."""
    recovery_speed: wp.array[float]
    """Speed at which each collider moves particles out of itself [m/s]."""
    compliance: wp.array2d[wp.vec2]
    """Compliance of a soft surface normal to and along itself [m/N], 0 if it is rigid. This array
    and those below have no rows if no collider is soft."""
    borne: wp.array2d[wp.vec3]
    """Part of the force on the particle to which flesh has yielded so far [N]."""
    borne_before: wp.array2d[wp.vec3]
    held: wp.array2d[wp.vec3]
    """Part of the force to which joints have yielded so far [N]."""
    held_before: wp.array2d[wp.vec3]
    lean: wp.array2d[wp.vec3]
    """Displacement by which flesh and joints together have yielded [m]."""
    face: wp.array2d[int]
    """Face of the contact on a soft surface; ``place`` has the barycentric coordinates."""
    place: wp.array2d[wp.vec2]


@wp.func
def tangential(vector: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """Component of a vector along a surface."""
    return vector - normal * wp.dot(vector, normal)


@wp.func
def press_contacts(
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    mass: wp.array[float],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
    own_block: wp.array[wp.mat33],
    i: int,
) -> None:
    """Add contact impulses and their tangent to the system: the only contact law.

    The normal force is a stiffness times the penetration; friction is the same stiffness times the
    slip of the anchor, but at most μ times the normal impulse that the last solve applied. The
    penetration at a velocity not yet solved for would allow a far larger one.
    """
    dt = common.time_step
    block = wp.identity(n=3, dtype=float) * mass[material[i]]
    contact_count = slots.count[i]
    if contact_count > 0:
        stiffness = CONTACT_STIFFNESS * wp.trace(diagonal[i]) / 3.0
        contacts = wp.mat33()
        push = wp.vec3()
        for k in range(contact_count):
            n = slots.normal[i, k]
            relative = velocity[i] * dt - slots.surface_motion[i, k]
            gap = slots.gap[i, k]
            hold = slots.adhesion[slots.collider[i, k]] * dt
            if slots.normal_stiffness[i, k] > 0.0:
                solved = wp.dot(change[i], n) * slots.normal_stiffness[i, k]
                load = wp.dot(slots.impulse[i, k], n) - solved + hold
                slots.push[i, k] = wp.max(load, STICKING * hold)
            speed = slots.recovery_speed[slots.collider[i, k]]
            allowed = wp.min(gap + speed * dt, 0.0)
            depth = allowed - gap - wp.dot(relative, n)
            across = stiffness
            along = stiffness
            lean = wp.vec3()
            beyond = float(0.0)
            if i < slots.compliance.shape[0]:
                # The surface yields as the force changes: the two are springs in series, and the
                # far end is where the surface would be without the force.
                lean = slots.lean[i, k]
                depth += wp.dot(lean, n)
                # Deeper than flesh can yield in time, it is like bone: nothing gets through.
                inner = gap + SOFT_DEPTH * common.radius
                allowed = wp.min(inner + wp.min(speed, DEPENETRATION_SPEED) * dt, 0.0)
                beyond = allowed - inner - wp.dot(relative, n)
                gives = slots.compliance[i, k] * (stiffness / (dt * dt))
                across = stiffness / (1.0 + gives[0])
                along = stiffness / (1.0 + gives[1])
            impulse = wp.vec3()
            normal_stiffness = float(0.0)
            friction_stiffness = float(0.0)
            if depth > 0.0 or (hold > 0.0 and slots.push[i, k] > 0.0):
                normal_stiffness = across
                normal_push = across * depth / dt
                if normal_push < -hold:
                    normal_push = -hold
                    normal_stiffness = hold * dt / -depth
                if beyond > 0.0 and stiffness > across:
                    normal_stiffness = stiffness
                    normal_push += (stiffness - across) * beyond / dt
                slip = tangential(relative - lean, n) + slots.anchor[i, k]
                slip_length = wp.min(wp.length(slip), slots.slide[i, k])
                slots.slide[i, k] = UNKNOWN_SLIDE
                limit = friction[material[i], slots.collider[i, k]] * slots.push[i, k]
                friction_stiffness = wp.min(along, limit * dt / wp.max(slip_length, 1.0e-12))
                impulse = n * normal_push - slip * (friction_stiffness / dt)
                contacts += (
                    wp.outer(n, n) * (normal_stiffness - friction_stiffness)
                    + wp.identity(n=3, dtype=float) * friction_stiffness
                )
                push += impulse
            slots.impulse[i, k] = impulse
            slots.normal_stiffness[i, k] = normal_stiffness
            slots.friction_stiffness[i, k] = friction_stiffness
            slots.stick_stiffness[i, k] = along
        residual[i] = residual[i] + push
        diagonal[i] = diagonal[i] + contacts
        block += contacts
    own_block[i] = block


@wp.kernel(enable_backward=False)
def press_all_contacts(
    awake: Awake,
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    mass: wp.array[float],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
    own_block: wp.array[wp.mat33],
) -> None:
    """`press_contacts` for each particle."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        press_contacts(
            common,
            friction,
            material,
            mass,
            velocity,
            change,
            slots,
            residual,
            diagonal,
            own_block,
            i,
        )


@wp.func
def settle_contacts(
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
    i: int,
) -> None:
    """Sum the impulses that the solve applied, and let anchors stretch or slide.

    The impulse is the linearized one of the solve, which is what changed the momentum.
    """
    dt = common.time_step
    for k in range(slots.count[i]):
        n = slots.normal[i, k]
        relative = velocity[i] * dt - slots.surface_motion[i, k]
        normal_stiffness = slots.normal_stiffness[i, k]
        if normal_stiffness > 0.0:
            held = slots.friction_stiffness[i, k]
            along = wp.dot(change[i], n)
            applied = (
                slots.impulse[i, k]
                - n * (along * normal_stiffness)
                - (change[i] - n * along) * held
            )
            slots.impulse[i, k] = applied
            wp.atomic_add(impulse, slots.collider[i, k], wp.vec3d(-applied))
            lean = wp.vec3()
            if i < slots.compliance.shape[0]:
                lean = slots.lean[i, k]
            slip = tangential(relative - lean, n) + slots.anchor[i, k]
            slip_length = wp.length(slip)
            hold = slots.adhesion[slots.collider[i, k]] * dt
            load = wp.max(wp.dot(applied, n) + hold, STICKING * hold)
            limit = friction[material[i], slots.collider[i, k]] * load
            max_slip = limit * dt / slots.stick_stiffness[i, k]
            held_slip = slip * wp.min(1.0, max_slip / wp.max(slip_length, 1.0e-12))
            slots.anchor[i, k] = held_slip + tangential(lean, n)
            slots.slide[i, k] = slip_length
            slots.push[i, k] = load
        else:
            slots.anchor[i, k] = wp.vec3()
            slots.slide[i, k] = UNKNOWN_SLIDE
            slots.push[i, k] = 0.0
        wp.atomic_max(deepest, 0, -slots.gap[i, k] - wp.dot(relative, n))


@wp.kernel(enable_backward=False)
def settle_all_contacts(
    awake: Awake,
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
) -> None:
    """`settle_contacts` for each particle."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        settle_contacts(common, friction, material, velocity, change, slots, impulse, deepest, i)


@wp.kernel(enable_backward=False)
def rest_contacts(
    resting: wp.array[int],
    time_step: float,
    slots: ContactSlots,
    force: wp.array[wp.vec3d],
) -> None:
    """Store the contact forces of particles that fall asleep.

    While they sleep, their slots hold forces [N] instead of impulses.
    """
    i = resting[wp.tid()]
    for k in range(slots.count[i]):
        slots.impulse[i, k] = slots.impulse[i, k] / time_step
        wp.atomic_add(force, slots.collider[i, k], wp.vec3d(-slots.impulse[i, k]))


@wp.kernel(enable_backward=False)
def wake_contacts(
    woken: wp.array[int],
    time_step: float,
    slots: ContactSlots,
    clearance: wp.array2d[float],
    force: wp.array[wp.vec3d],
) -> None:
    """Turn stored forces back into impulses, and have contacts searched again."""
    i = woken[wp.tid()]
    for k in range(slots.count[i]):
        wp.atomic_add(force, slots.collider[i, k], wp.vec3d(slots.impulse[i, k]))
        slots.impulse[i, k] = slots.impulse[i, k] * time_step
    for mesh in range(clearance.shape[0]):
        clearance[mesh, i] = 0.0
