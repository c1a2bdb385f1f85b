# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact and Coulomb friction between clay particles and planes or moving closed meshes.

A particle is a ball of half the spacing. Contacts are found once a substep and then stay what
they are, a plane each; how hard they push is part of the implicit solve. Friction holds a contact
by an anchor (Barreiro, Torres and Otaduy, WHC 2021, section III-D; Yamane and Nakamura, ICRA
2006): a spring that slides where its force would exceed μ times the normal force. What lies inside
a collider is moved out no faster than `DEPENETRATION_SPEED`.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .scene import MeshCollider, Plane

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


@wp.kernel(enable_backward=False)
def blend_vertices(
    start: wp.array[wp.vec3],
    end: wp.array[wp.vec3],
    fraction: float,
    points: wp.array[wp.vec3],
) -> None:
    """Move a deforming mesh to a fraction of its way."""
    i = wp.tid()
    points[i] = start[i] + (end[i] - start[i]) * fraction


class Contacts:
    """Contacts of all particles with all colliders.

    Args:
        particle_count: Number of particles.
        device: Warp device.
    """

    def __init__(self, particle_count: int, device: wp.Device) -> None:
        rows = (particle_count, MOST_CONTACTS)
        self.device = device
        self.particle_count = particle_count
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
        slots.count = wp.zeros(particle_count, dtype=int, device=device)
        slots.count_before = wp.zeros(particle_count, dtype=int, device=device)
        self.slots = slots

    def begin(self) -> None:
        """Set the last substep's contacts aside, to find their anchors again."""
        slots = self.slots
        wp.copy(slots.count_before, slots.count)
        wp.copy(slots.collider_before, slots.collider)
        wp.copy(slots.anchor_before, slots.anchor)
        slots.count.zero_()

    def snapshot(self) -> dict[str, NDArray]:
        """Anchors and what they hold on to."""
        return {
            "contact_count": self.slots.count.numpy().copy(),
            "contact_collider": self.slots.collider.numpy().copy(),
            "contact_anchor": self.slots.anchor.numpy().copy(),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        self.slots.count.assign(state["contact_count"])
        self.slots.collider.assign(state["contact_collider"])
        self.slots.anchor.assign(state["contact_anchor"])


class PlaneContacts:
    """All planes of a scene.

    Args:
        planes: The planes.
        device: Warp device.
    """

    def __init__(self, planes: list[Plane], device: wp.Device) -> None:
        points = np.array([plane.point for plane in planes], np.float32)
        normals = np.array([plane.normal for plane in planes], np.float32)
        self.point = wp.array(points, dtype=wp.vec3, device=device)
        self.normal = wp.array(normals, dtype=wp.vec3, device=device)


@dataclass
class _MovingMesh:
    """One mesh collider on the device, and where it stood at the end of the last step."""

    collider: MeshCollider
    mesh: wp.Mesh
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    vertices: NDArray[np.float64]
    orientation: float
    shape_version: int
    start: wp.array | None = None
    end: wp.array | None = None

    def world(self) -> NDArray[np.float64]:
        return self.vertices @ self.rotation.T + self.translation


class MeshContacts:
    """All mesh colliders of a scene.

    A collider's pose is split into a rigid part, which moves the query point, and a stretch,
    which is applied to the vertices; only a change of shape refits the mesh.

    Args:
        colliders: The colliders, at their poses of now.
        particle_count: Number of clay particles.
        device: Warp device.
    """

    def __init__(
        self, colliders: list[MeshCollider], particle_count: int, device: wp.Device
    ) -> None:
        self.device = device
        self.moving: list[_MovingMesh] = []
        for collider in colliders:
            rotation, translation, vertices, orientation = _rigid_and_shape(collider)
            mesh = wp.Mesh(
                points=wp.array(vertices, dtype=wp.vec3, device=device),
                indices=wp.array(collider.faces.ravel(), dtype=int, device=device),
                velocities=wp.zeros(len(vertices), dtype=wp.vec3, device=device),
                support_winding_number=True,
            )
            self.moving.append(
                _MovingMesh(
                    collider,
                    mesh,
                    rotation,
                    translation,
                    vertices,
                    orientation,
                    collider.shape_version,
                )
            )
        count = len(colliders)
        self.mesh = wp.array([m.mesh.id for m in self.moving], dtype=wp.uint64, device=device)
        self.reach = wp.zeros(count, dtype=float, device=device)
        self.travel = wp.zeros(count, dtype=float, device=device)
        self.orientation = wp.array(
            [m.orientation for m in self.moving], dtype=float, device=device
        )
        self.pose = wp.zeros((count, 8), dtype=wp.transform, device=device)
        self.clearance = wp.zeros((count, particle_count), dtype=float, device=device)
        self._targets: list[tuple] = []

    def farthest_motion(self) -> list[float]:
        """How far any vertex of each collider is going to move in this step [m]."""
        self._targets = []
        motions = []
        for moving in self.moving:
            target = _rigid_and_shape(moving.collider)
            self._targets.append(target)
            end = target[2] @ target[0].T + target[1]
            motions.append(float(np.linalg.norm(end - moving.world(), axis=1).max()))
        return motions

    def begin_step(self, substeps: int, motions: list[float], teleported: list[bool]) -> None:
        """Lay out the colliders' way through the coming substeps.

        Args:
            substeps: Number of substeps.
            motions: What `farthest_motion` gave [m].
            teleported: Colliders that jump to their target at once instead of sweeping there.
        """
        poses = np.zeros((len(self.moving), substeps + 1, 7), np.float32)
        reach = np.zeros(len(self.moving), np.float32)
        for which, (moving, target) in enumerate(zip(self.moving, self._targets, strict=True)):
            rotation, translation, vertices, orientation = target
            if orientation != moving.orientation:
                self.orientation.assign(np.array([t[3] for t in self._targets], np.float32))
            start_rotation, start_translation = moving.rotation, moving.translation
            start_vertices = moving.vertices
            if teleported[which]:
                start_rotation, start_translation = rotation, translation
                start_vertices = vertices
                row = self.clearance.numpy()
                row[which] = 0.0
                self.clearance.assign(row)
            poses[which] = _way(start_rotation, rotation, start_translation, translation, substeps)
            deforms = moving.shape_version != moving.collider.shape_version and not (
                np.allclose(start_vertices, vertices, rtol=0.0, atol=1e-9)
            )
            if deforms:
                moving.start = wp.array(start_vertices, dtype=wp.vec3, device=self.device)
                moving.end = wp.array(vertices, dtype=wp.vec3, device=self.device)
                moving.mesh.velocities.assign(
                    ((vertices - start_vertices) / substeps).astype(np.float32)
                )
            else:
                if moving.end is not None or teleported[which]:
                    moving.mesh.velocities.zero_()
                    moving.mesh.points.assign(vertices.astype(np.float32))
                    moving.mesh.refit()
                moving.start = moving.end = None
            reach[which] = 0.5 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
            moving.rotation, moving.translation = rotation, translation
            moving.vertices, moving.orientation = vertices, orientation
            moving.shape_version = moving.collider.shape_version
        self.reach.assign(reach)
        self.travel.assign(
            np.array(
                [0.0 if t else m / substeps for m, t in zip(motions, teleported, strict=True)],
                np.float32,
            )
        )
        room = self.pose.shape[1]
        while room < substeps + 1:
            room *= 2
        if room != self.pose.shape[1]:
            self.pose = wp.zeros((len(self.moving), room), dtype=wp.transform, device=self.device)
        filled = np.zeros((len(self.moving), room, 7), np.float32)
        filled[:, : substeps + 1] = poses
        self.pose.assign(filled)

    def begin_substep(self, substep: int, substeps: int) -> None:
        """Bring deforming meshes to the end of a substep."""
        for moving in self.moving:
            if moving.start is not None:
                wp.launch(
                    blend_vertices,
                    dim=len(moving.vertices),
                    inputs=[moving.start, moving.end, (substep + 1) / substeps, moving.mesh.points],
                    device=self.device,
                )
                moving.mesh.refit()

    def snapshot(self) -> dict[str, NDArray]:
        """Where the colliders stood at the end of the last step."""
        state: dict[str, NDArray] = {"collider_clearance": self.clearance.numpy().copy()}
        for which, moving in enumerate(self.moving):
            state[f"collider_{which}_rotation"] = moving.rotation.copy()
            state[f"collider_{which}_translation"] = moving.translation.copy()
            state[f"collider_{which}_vertices"] = moving.vertices.copy()
            state[f"collider_{which}_orientation"] = np.array(moving.orientation)
        return state

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        self.clearance.assign(state["collider_clearance"])
        for which, moving in enumerate(self.moving):
            moving.rotation = state[f"collider_{which}_rotation"].copy()
            moving.translation = state[f"collider_{which}_translation"].copy()
            moving.vertices = state[f"collider_{which}_vertices"].copy()
            moving.orientation = float(state[f"collider_{which}_orientation"])
            moving.shape_version = -1
            moving.start = moving.end = None
            moving.mesh.velocities.zero_()
            moving.mesh.points.assign(moving.vertices.astype(np.float32))
            moving.mesh.refit()
        self.orientation.assign(np.array([m.orientation for m in self.moving], np.float32))


def _rigid_and_shape(
    collider: MeshCollider,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Split a pose into rotation, translation and stretched vertices (polar decomposition)."""
    linear = collider.pose[:3, :3]
    left, scales, right = np.linalg.svd(linear)
    rotation = left @ right
    stretch = right.T @ np.diag(scales) @ right
    orientation = 1.0
    if np.linalg.det(rotation) < 0.0:
        rotation, stretch, orientation = -rotation, -stretch, -1.0
    return rotation, collider.pose[:3, 3].copy(), collider.vertices @ stretch.T, orientation


def _way(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    start_translation: NDArray[np.float64],
    end_translation: NDArray[np.float64],
    substeps: int,
) -> NDArray[np.float32]:
    """Poses from start to end: straight, at constant angular velocity; shape [S + 1, 7]."""
    fraction = np.linspace(0.0, 1.0, substeps + 1)[:, None]
    first, last = _quaternion(start), _quaternion(end)
    cosine = float(first @ last)
    if cosine < 0.0:
        last, cosine = -last, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        turn = first + (last - first) * fraction
    else:
        turn = (np.sin((1.0 - fraction) * angle) * first + np.sin(fraction * angle) * last) / (
            np.sin(angle)
        )
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    place = start_translation + (end_translation - start_translation) * fraction
    return np.concatenate([place, turn], axis=1).astype(np.float32)


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternion (x, y, z, w) of a rotation matrix, by its dominant component."""
    m = rotation
    squares = np.array(
        [
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    rows = np.array(
        [
            [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
            [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
        ]
    )
    quaternion = rows[largest]
    return quaternion / np.linalg.norm(quaternion)
