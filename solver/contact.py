# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact and Coulomb friction between clay particles and planes or moving closed meshes.

A particle is a ball of half the spacing. Contact is inelastic: what would enter is stopped at
the surface, and the friction correction is at most μ times the normal one (Barreiro, Torres and
Otaduy, WHC 2021, section III-D). What already lies inside is pushed out no faster than
`DEPENETRATION_SPEED`, without gaining velocity and without counting as force.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .scene import MeshCollider, Plane

DEPENETRATION_SPEED = 0.5
"""Speed at which something that lies inside a collider is moved out [m/s]."""


@wp.struct
class ContactPass:
    """What all contacts share, for one time step."""

    time_step: float
    radius: float
    """Radius of a particle [m]."""


@wp.struct
class Contact:
    """Outcome of one contact for a particle."""

    motion: wp.vec3
    """Its motion in this substep after the contact [m]."""
    push: wp.vec3
    """The part that only moves it out, without velocity [m]."""
    impulse: wp.vec3
    """The part that counts as force [m]; times m/Δt it is the impulse on the particle."""


@wp.func
def resolve_contact(
    common: ContactPass,
    motion: wp.vec3,
    surface_motion: wp.vec3,
    normal: wp.vec3,
    gap: float,
    friction: float,
) -> Contact:
    """Stop a particle at a surface: the one contact law.

    Args:
        common: The step's values.
        motion: What the particle is about to move [m].
        surface_motion: What the surface moves at the contact [m].
        normal: Out of the collider, unit length.
        gap: Distance left between ball and surface after both motions [m], negative inside.
        friction: Coulomb coefficient.
    """
    contact = Contact()
    contact.motion = motion
    gap_before = gap - wp.dot(motion - surface_motion, normal)
    allowed = DEPENETRATION_SPEED * common.time_step
    correction = wp.min(gap_before + allowed, 0.0) - gap
    if correction > 0.0:
        push = wp.clamp(-gap_before, 0.0, wp.min(allowed, correction))
        normal_part = correction - push
        motion += normal * correction
        slip = motion - surface_motion
        slip -= normal * wp.dot(slip, normal)
        slip_length = wp.length(slip)
        held = wp.vec3()
        if slip_length > 0.0:
            held = -slip * wp.min(1.0, friction * normal_part / slip_length)
        contact.motion = motion + held
        contact.push = normal * push
        contact.impulse = normal * normal_part + held
    return contact


@wp.kernel(enable_backward=False)
def collide_planes(
    common: ContactPass,
    plane_point: wp.array[wp.vec3],
    plane_normal: wp.array[wp.vec3],
    friction: wp.array2d[float],
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    push: wp.array[wp.vec3],
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
):
    """Keep particles on the free side of every plane."""
    i = wp.tid()
    x = position[i]
    for plane in range(plane_point.shape[0]):
        motion = velocity[i] * common.time_step + push[i]
        normal = plane_normal[plane]
        gap = wp.dot(x + motion - plane_point[plane], normal) - common.radius
        if gap < 0.0:
            contact = resolve_contact(
                common, motion, wp.vec3(), normal, gap, friction[material[i], plane]
            )
            push[i] = push[i] + contact.push
            velocity[i] = (contact.motion - push[i]) / common.time_step
            scale = mass[material[i]] / common.time_step
            wp.atomic_add(impulse, plane, wp.vec3d(-contact.impulse * scale))
            wp.atomic_max(deepest, 0, wp.dot(motion, normal) - gap)


@wp.kernel(enable_backward=False)
def collide_meshes(
    common: ContactPass,
    substep: int,
    first_friction: int,
    mesh: wp.array[wp.uint64],
    pose: wp.array2d[wp.transform],
    orientation: wp.array[float],
    reach: wp.array[float],
    travel: wp.array[float],
    friction: wp.array2d[float],
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    clearance: wp.array2d[float],
    velocity: wp.array[wp.vec3],
    push: wp.array[wp.vec3],
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
):
    """Keep particles out of every mesh.

    ``clearance`` is a lower bound on a particle's distance to a mesh [m]: while motion cannot
    have used it up, the mesh is not asked.
    """
    i = wp.tid()
    x = position[i]
    for which in range(mesh.shape[0]):
        motion = velocity[i] * common.time_step + push[i]
        bound = clearance[which, i] - wp.length(motion) - travel[which]
        if bound > common.radius:
            clearance[which, i] = bound
            continue
        before = pose[which, substep]
        after = pose[which, substep + 1]
        local = wp.transform_point(wp.transform_inverse(after), x + motion)
        query = wp.mesh_query_point_sign_winding_number(mesh[which], local, reach[which])
        if not query.result:
            clearance[which, i] = reach[which]
            continue
        nearest = wp.mesh_eval_position(mesh[which], query.face, query.u, query.v)
        sign = query.sign
        offset = local - nearest
        distance = wp.length(offset)
        clearance[which, i] = sign * distance
        gap = sign * distance - common.radius
        if gap < 0.0:
            if distance > 1.0e-4 * common.radius:
                normal = offset * (sign / distance)
            else:
                normal = wp.mesh_eval_face_normal(mesh[which], query.face) * orientation[which]
            normal = wp.transform_vector(after, normal)
            drift = wp.mesh_eval_velocity(mesh[which], query.face, query.u, query.v)
            surface_motion = wp.transform_point(after, nearest) - wp.transform_point(
                before, nearest - drift
            )
            contact = resolve_contact(
                common, motion, surface_motion, normal, gap,
                friction[material[i], first_friction + which],
            )
            push[i] = push[i] + contact.push
            velocity[i] = (contact.motion - push[i]) / common.time_step
            scale = mass[material[i]] / common.time_step
            wp.atomic_add(impulse, first_friction + which, wp.vec3d(-contact.impulse * scale))
            wp.atomic_max(deepest, 0, wp.dot(motion - surface_motion, normal) - gap)


@wp.kernel(enable_backward=False)
def blend_vertices(
    start: wp.array[wp.vec3],
    end: wp.array[wp.vec3],
    fraction: float,
    points: wp.array[wp.vec3],
):
    """Move a deforming mesh to a fraction of its way."""
    i = wp.tid()
    points[i] = start[i] + (end[i] - start[i]) * fraction


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
                    collider, mesh, rotation, translation, vertices, orientation,
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
        self.pose = wp.zeros((count, 2), dtype=wp.transform, device=device)
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
            poses[which] = _way(
                start_rotation, rotation, start_translation, translation, substeps
            )
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
        if self.pose.shape[1] != substeps + 1:
            self.pose = wp.zeros(
                (len(self.moving), substeps + 1), dtype=wp.transform, device=self.device
            )
        self.pose.assign(poses)

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
