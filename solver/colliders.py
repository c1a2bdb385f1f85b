# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders on the device: where planes stand, and the way of meshes through a step."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .polar import rotation_and_stretch
from .scene import MeshCollider, Plane


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


class PlaneColliders:
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


class MeshColliders:
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
        self.generation = 0
        self.substep = wp.zeros(1, dtype=int, device=device)
        """Which of a step's substeps is under way; on the device, so that it can be recorded."""
        self.clearance = wp.zeros((count, particle_count), dtype=float, device=device)
        self._targets: list[tuple] = []

    def farthest_motion(self) -> tuple[list[float], list[NDArray[np.float64]]]:
        """How far any vertex of each collider is going to move in this step, and where.

        Returns:
            Distances [m], and the boxes that the colliders sweep, shape [2, 3] each: lowest and
            highest corner [m].
        """
        self._targets = []
        motions = []
        boxes = []
        for moving in self.moving:
            target = _rigid_and_shape(moving.collider)
            self._targets.append(target)
            end = target[2] @ target[0].T + target[1]
            begin = moving.world()
            motions.append(float(np.linalg.norm(end - begin, axis=1).max()))
            low = np.minimum(begin.min(0), end.min(0))
            boxes.append(np.array([low, np.maximum(begin.max(0), end.max(0))]))
        return motions, boxes

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
                np.allclose(start_vertices, vertices, rtol=0.0, atol=1e-6 * _size(vertices))
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
            reach[which] = 0.5 * _size(vertices)
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
            self.generation += 1
        filled = np.zeros((len(self.moving), room, 7), np.float32)
        filled[:, : substeps + 1] = poses
        self.pose.assign(filled)

    def begin_substep(self, substep: int, substeps: int) -> None:
        """Bring deforming meshes to the end of a substep."""
        self.substep.fill_(substep)
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
    rotation, stretch = rotation_and_stretch(collider.pose[:3, :3])
    orientation = 1.0 if np.linalg.det(stretch) > 0.0 else -1.0
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


def _size(vertices: NDArray[np.float64]) -> float:
    """Length of the bounding box's diagonal [m]."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))
