# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact and Coulomb friction between clay particles and planes or moving closed meshes.

A particle is a ball of half the spacing. Contacts are found once a substep and then stay what
they are, a plane each; how hard they push is part of the implicit solve. Friction holds a contact
by an anchor (Barreiro, Torres and Otaduy, WHC 2021, section III-D; Yamane and Nakamura, ICRA
2006): a spring that slides where its force would exceed μ times the normal force. What lies inside
a collider is moved out no faster than `DEPENETRATION_SPEED`.
"""

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .colliders import MeshColliders, PlaneColliders
from .particles import Particles
from .scene import MeshCollider, Plane, Scene

DEPENETRATION_SPEED = 0.5
"""Speed at which something that lies inside a collider is moved out [m/s]."""
MOST_CONTACTS = 4
"""Contacts that a particle can have at once."""
MARGIN = 0.25
"""Contacts are found this far off the surface, in spacings: a substep may close the gap."""
CONTACT_STIFFNESS = 2.0
"""Stiffness of a contact over that of the clay around the particle."""


@wp.struct
class ContactPass:
    """What all contacts share, for one substep."""

    time_step: float
    time_step_before: float
    radius: float
    """Radius of a particle [m]."""
    margin: float
    """How far off contacts are found [m]."""


@wp.struct
class ContactSlots:
    """Contacts of all particles, `MOST_CONTACTS` for each."""

    count: wp.array[int]
    collider: wp.array2d[int]
    normal: wp.array2d[wp.vec3]
    gap: wp.array2d[float]
    """Distance between ball and surface at the start of the substep [m]."""
    surface_motion: wp.array2d[wp.vec3]
    """What the surface moves in this substep [m]."""
    anchor: wp.array2d[wp.vec3]
    """Stretch of the friction spring [m]."""
    impulse: wp.array2d[wp.vec3]
    """Impulse on the particle at the velocities last looked at [N s]."""
    normal_stiffness: wp.array2d[float]
    """[kg]: force derivative times Δt²."""
    friction_stiffness: wp.array2d[float]
    """[kg]; less than the normal one where the contact slides."""
    count_before: wp.array[int]
    collider_before: wp.array2d[int]
    anchor_before: wp.array2d[wp.vec3]


@wp.func
def add_contact(
    slots: ContactSlots,
    i: int,
    collider: int,
    normal: wp.vec3,
    gap: float,
    surface_motion: wp.vec3,
) -> None:
    """Give a particle a contact, with the anchor that it had on this collider before."""
    used = slots.count[i]
    if used < MOST_CONTACTS:
        slots.collider[i, used] = collider
        slots.normal[i, used] = normal
        slots.gap[i, used] = gap
        slots.surface_motion[i, used] = surface_motion
        slots.impulse[i, used] = wp.vec3()
        anchor = wp.vec3()
        for k in range(slots.count_before[i]):
            if slots.collider_before[i, k] == collider:
                anchor = slots.anchor_before[i, k]
        slots.anchor[i, used] = anchor - normal * wp.dot(anchor, normal)
        slots.count[i] = used + 1


@wp.kernel(enable_backward=False)
def find_plane_contacts(
    common: ContactPass,
    plane_point: wp.array[wp.vec3],
    plane_normal: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
) -> None:
    """Find the planes that a particle may touch in this substep."""
    i = wp.tid()
    for plane in range(plane_point.shape[0]):
        normal = plane_normal[plane]
        gap = wp.dot(position[i] - plane_point[plane], normal) - common.radius
        closing = wp.max(-wp.dot(velocity[i], normal), 0.0) * common.time_step
        if gap - closing < common.margin:
            add_contact(slots, i, plane, normal, gap, wp.vec3())


@wp.kernel(enable_backward=False)
def find_mesh_contacts(
    common: ContactPass,
    substep: wp.array[int],
    first_collider: int,
    mesh: wp.array[wp.uint64],
    pose: wp.array2d[wp.transform],
    orientation: wp.array[float],
    reach: wp.array[float],
    travel: wp.array[float],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    clearance: wp.array2d[float],
    slots: ContactSlots,
) -> None:
    """Find the meshes that a particle may touch in this substep.

    ``clearance`` is a lower bound on a particle's distance to a mesh [m]: while motion cannot
    have used it up, the mesh is not asked.
    """
    i = wp.tid()
    x = position[i]
    motion = velocity[i] * common.time_step
    moved = wp.length(velocity[i]) * common.time_step_before
    near = common.radius + common.margin
    for which in range(mesh.shape[0]):
        bound = clearance[which, i] - moved - travel[which]
        clearance[which, i] = bound
        if bound - wp.length(motion) > near:
            continue
        before = pose[which, substep[0]]
        after = pose[which, substep[0] + 1]
        local = wp.transform_point(wp.transform_inverse(after), x + motion)
        query = wp.mesh_query_point_sign_winding_number(mesh[which], local, reach[which])
        if not query.result:
            clearance[which, i] = reach[which] - wp.length(motion)
            continue
        nearest = wp.mesh_eval_position(mesh[which], query.face, query.u, query.v)
        sign = query.sign
        offset = local - nearest
        apart = wp.length(offset)
        clearance[which, i] = sign * apart - wp.length(motion)
        if sign * apart < near:
            if apart > 1.0e-4 * common.radius:
                normal = offset * (sign / apart)
            else:
                normal = wp.mesh_eval_face_normal(mesh[which], query.face) * orientation[which]
            normal = wp.transform_vector(after, normal)
            drift = wp.mesh_eval_velocity(mesh[which], query.face, query.u, query.v)
            surface_motion = wp.transform_point(after, nearest) - wp.transform_point(
                before, nearest - drift
            )
            gap = sign * apart - common.radius - wp.dot(motion - surface_motion, normal)
            add_contact(slots, i, first_collider + which, normal, gap, surface_motion)


@wp.kernel(enable_backward=False)
def press_contacts(
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    mass: wp.array[float],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
    own_block: wp.array[wp.mat33],
) -> None:
    """Add contact impulses and their tangent to the system: the one contact law.

    A contact pushes with a stiffness times its penetration, tangentially with that stiffness
    times the slip of its anchor, but at most μ times the normal push.
    """
    i = wp.tid()
    dt = common.time_step
    block = wp.identity(n=3, dtype=float) * mass[material[i]]
    contact_count = int(0)
    if i < slots.count.shape[0]:
        contact_count = slots.count[i]
    if contact_count > 0:
        stiffness = CONTACT_STIFFNESS * wp.trace(diagonal[i]) / 3.0
        contacts = wp.mat33()
        push = wp.vec3()
        for k in range(contact_count):
            n = slots.normal[i, k]
            relative = velocity[i] * dt - slots.surface_motion[i, k]
            gap = slots.gap[i, k]
            allowed = wp.min(gap + DEPENETRATION_SPEED * dt, 0.0)
            depth = allowed - gap - wp.dot(relative, n)
            impulse = wp.vec3()
            normal_stiffness = float(0.0)
            friction_stiffness = float(0.0)
            if depth > 0.0:
                normal_stiffness = stiffness
                normal_push = stiffness * depth / dt
                slip = relative - n * wp.dot(relative, n) + slots.anchor[i, k]
                slip_length = wp.length(slip)
                limit = friction[material[i], slots.collider[i, k]] * normal_push
                friction_stiffness = wp.min(stiffness, limit * dt / wp.max(slip_length, 1.0e-12))
                impulse = n * normal_push - slip * (friction_stiffness / dt)
                contacts += (
                    wp.outer(n, n) * (normal_stiffness - friction_stiffness)
                    + wp.identity(n=3, dtype=float) * friction_stiffness
                )
                push += impulse
            slots.impulse[i, k] = impulse
            slots.normal_stiffness[i, k] = normal_stiffness
            slots.friction_stiffness[i, k] = friction_stiffness
        residual[i] = residual[i] + push
        diagonal[i] = diagonal[i] + contacts
        block += contacts
    own_block[i] = block


@wp.kernel(enable_backward=False)
def settle_contacts(
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
) -> None:
    """Sum the impulses that the solve applied, and let anchors stretch or slide.

    The impulse is the linear one that the solve saw: what momentum really changed by.
    """
    i = wp.tid()
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
            slip = relative - n * wp.dot(relative, n) + slots.anchor[i, k]
            slip_length = wp.length(slip)
            limit = friction[material[i], slots.collider[i, k]] * wp.max(wp.dot(applied, n), 0.0)
            most = limit * dt / normal_stiffness
            slots.anchor[i, k] = slip * wp.min(1.0, most / wp.max(slip_length, 1.0e-12))
        else:
            slots.anchor[i, k] = wp.vec3()
        wp.atomic_max(deepest, 0, -slots.gap[i, k] - wp.dot(relative, n))


class Contacts:
    """Contacts of all particles with all colliders.

    A scene without colliders keeps no slots.

    Args:
        scene: Its planes and meshes are the colliders, in this order.
        particles: What they touch.
        friction: Whether friction acts.
    """

    def __init__(self, scene: Scene, particles: Particles, *, friction: bool) -> None:
        self.particles = particles
        self.device = device = particles.device
        self.colliders: list[Plane | MeshCollider] = [*scene.planes, *scene.meshes]
        self.planes = PlaneColliders(scene.planes, device) if scene.planes else None
        self.meshes = MeshColliders(scene.meshes, particles.count, device) if scene.meshes else None
        self._plane_count = len(scene.planes)
        rows = (particles.count if self.colliders else 0, MOST_CONTACTS)
        slots = ContactSlots()
        for name, dtype in (
            ("collider", int),
            ("normal", wp.vec3),
            ("gap", float),
            ("surface_motion", wp.vec3),
            ("anchor", wp.vec3),
            ("impulse", wp.vec3),
            ("normal_stiffness", float),
            ("friction_stiffness", float),
            ("collider_before", int),
            ("anchor_before", wp.vec3),
        ):
            setattr(slots, name, wp.zeros(rows, dtype=dtype, device=device))
        slots.count = wp.zeros(rows[0], dtype=int, device=device)
        slots.count_before = wp.zeros(rows[0], dtype=int, device=device)
        self.slots = slots
        table = np.zeros((max(len(particles.materials), 1), max(len(self.colliders), 1)))
        if friction:
            for row, material in enumerate(particles.materials):
                for column, collider in enumerate(self.colliders):
                    table[row, column] = math.sqrt(material.friction * collider.friction)
        self.friction = wp.array(table, dtype=float, device=device)
        """Of each material on each collider: the geometric mean of the two."""
        self.impulse = wp.zeros(len(self.colliders), dtype=wp.vec3d, device=device)
        """On each collider in this step [N s]."""
        self.deepest = wp.zeros(1, dtype=float, device=device)
        """How far any particle's ball lay inside a collider in this step [m]."""

    @property
    def generation(self) -> int:
        """Changes whenever an array gives way to another."""
        return self.meshes.generation if self.meshes else 0

    def begin_step(self) -> None:
        """Forget what the last step summed up."""
        self.impulse.zero_()
        self.deepest.zero_()

    def find(self, common: ContactPass) -> None:
        """Find the contacts of a substep; those that were there before keep their anchors."""
        if not self.colliders:
            return
        slots = self.slots
        wp.copy(slots.count_before, slots.count)
        wp.copy(slots.collider_before, slots.collider)
        wp.copy(slots.anchor_before, slots.anchor)
        slots.count.zero_()
        particles = self.particles
        motion = [particles.position, particles.velocity]
        if self.meshes:
            meshes = self.meshes
            wp.launch(
                find_mesh_contacts,
                dim=particles.count,
                inputs=[
                    common,
                    meshes.substep,
                    self._plane_count,
                    meshes.mesh,
                    meshes.pose,
                    meshes.orientation,
                    meshes.reach,
                    meshes.travel,
                    *motion,
                    meshes.clearance,
                    slots,
                ],
                device=self.device,
            )
        if self.planes:
            wp.launch(
                find_plane_contacts,
                dim=particles.count,
                inputs=[common, self.planes.point, self.planes.normal, *motion, slots],
                device=self.device,
            )

    def press(
        self, common: ContactPass, residual: wp.array, diagonal: wp.array, own_block: wp.array
    ) -> None:
        """Add contact impulses and their tangent to the system of a substep.

        Args:
            common: The substep.
            residual: Impulse still missing at each particle [N s], added to.
            diagonal: Each particle's block of the tangent [kg], added to.
            own_block: Mass and contacts alone [kg], written.
        """
        particles = self.particles
        wp.launch(
            press_contacts,
            dim=particles.count,
            inputs=[
                common,
                self.friction,
                particles.material,
                particles.mass,
                particles.velocity,
                self.slots,
                residual,
                diagonal,
                own_block,
            ],
            device=self.device,
        )

    def settle(self, common: ContactPass, change: wp.array) -> None:
        """Sum the impulses on colliders and move anchors, once velocities are final.

        Args:
            common: The substep.
            change: What the last solve changed of the velocities [m/s].
        """
        if not self.colliders:
            return
        particles = self.particles
        wp.launch(
            settle_contacts,
            dim=particles.count,
            inputs=[
                common,
                self.friction,
                particles.material,
                particles.velocity,
                change,
                self.slots,
                self.impulse,
                self.deepest,
            ],
            device=self.device,
        )

    def snapshot(self) -> dict[str, NDArray]:
        """Anchors and what they hold on to, and where meshes stand."""
        if not self.colliders:
            return {}
        return {
            "contact_count": self.slots.count.numpy().copy(),
            "contact_collider": self.slots.collider.numpy().copy(),
            "contact_anchor": self.slots.anchor.numpy().copy(),
            **(self.meshes.snapshot() if self.meshes else {}),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        if not self.colliders:
            return
        self.slots.count.assign(state["contact_count"])
        self.slots.collider.assign(state["contact_collider"])
        self.slots.anchor.assign(state["contact_anchor"])
        if self.meshes:
            self.meshes.restore(state)
