# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh colliders and hands on the device, and their motion through a step."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.particles import Particles
from ..geometry.rotations import rotation_vectors_from_matrices
from ..scene.scene import MeshCollider, Scene
from ..soft_hand.soft_hand import SoftHand
from .shape import (
    ColliderShape,
    box_corners,
    box_diagonal,
    longest,
    poses_between,
    shape_of,
)

OUT_OF_REACH = 1.0e6
"""Clearance of a mesh or hand that cannot be touched [m]."""

BARELY = float(np.finfo(float).tiny)
"""A motion that wakes clay but needs no extra substeps [m]."""


@wp.kernel(enable_backward=False)
def blend_vertices(
    start: wp.array[wp.vec3],
    end: wp.array[wp.vec3],
    fraction: float,
    points: wp.array[wp.vec3],
) -> None:
    """Interpolate the vertices of a deforming mesh."""
    i = wp.tid()
    points[i] = start[i] + (end[i] - start[i]) * fraction


@dataclass
class _MovingMesh:
    """One mesh collider on the device, and its shape at the end of the last step."""

    collider: MeshCollider
    mesh: wp.Mesh
    shape: ColliderShape
    first: NDArray[np.float64]
    """The vertices that its search tree was made of, shape [V, 3]. A mesh that deforms keeps that
    tree, and of two faces that are as near as each other the tree says which is found: so a
    restored mesh must have the very same one."""
    start: wp.array | None = None
    end: wp.array | None = None
    enabled: bool = True
    """Whether clay could touch it in the last step."""


class Sweep(NamedTuple):
    """How far a collider's surface moves in a step.

    A turning wheel, or a plate sliding in its own plane, moves far but sweeps through nothing.
    """

    along: float
    """Largest motion along the surface normals [m]."""
    across: float
    """Largest motion in any direction, near the clay [m]."""
    turn: float
    """Angle of rotation [rad]."""


class MeshColliders:
    """All mesh colliders and hands of a scene.

    A collider's pose is split into a rigid part, which moves the query point, and a stretch,
    which is applied to the vertices; only a change of shape refits the mesh. The skin of a hand is
    in world coordinates.

    Args:
        scene: The colliders, at their current poses.
        particles: The clay.
    """

    def __init__(self, scene: Scene, particles: Particles) -> None:
        self.device = device = particles.device
        self.moving: list[_MovingMesh] = []
        for collider in scene.meshes:
            shape = shape_of(collider, None)
            mesh = _make_mesh(collider, shape, shape.vertices, device)
            self.moving.append(
                _MovingMesh(collider, mesh, shape, shape.vertices, enabled=collider.enabled)
            )
        count = len(scene.meshes) + len(scene.hands)
        self.reach = wp.zeros(count, dtype=float, device=device)
        self.travel = wp.zeros(count, dtype=float, device=device)
        self.orientation = wp.ones(count, dtype=float, device=device)
        self.pose = wp.zeros((count, 8), dtype=wp.transform, device=device)
        # Vector units read four floats at a time.
        self.pose_before = wp.zeros(count + 1, dtype=wp.transform, device=device)[:count]
        self._poses_before = np.tile(np.eye(1, 7, 6, np.float32), (count, 1))
        self._turned = np.zeros(count, bool)
        self.turning = wp.zeros(count, dtype=int, device=device)
        self.generation = 0
        self.substep = wp.zeros(1, dtype=int, device=device)
        """Index of the current substep; on the device, so that passes can be recorded."""
        self.clearance = wp.zeros((count, particles.count), dtype=float, device=device)
        self._targets: list[ColliderShape] = []
        faces = [len(hand.rig.faces) for hand in scene.hands]
        begin = np.concatenate([[0], np.cumsum(faces)]).astype(int)
        first_face = [-1] * len(scene.meshes) + begin[:-1].tolist()
        self.first_face = wp.array(first_face, dtype=int, device=device)
        """Where the faces of each mesh begin in ``compliance``; -1 for a rigid one."""
        self.compliance = wp.zeros(int(begin[-1]), dtype=wp.vec4, device=device)
        """Compliance of flesh and joints at each face of the hands [m/N]."""
        self.hands = [
            SoftHand(
                hand,
                collider=len(scene.planes) + len(scene.meshes) + index,
                row=len(scene.meshes) + index,
                first_face=int(begin[index]),
                compliance=self.compliance,
                travel=self.travel,
                particles=particles,
            )
            for index, hand in enumerate(scene.hands)
        ]
        self._contactless = [False] * count
        """Whether each mesh and hand was untouchable in the last step."""
        self.mesh = wp.zeros(count, dtype=wp.uint64, device=device)
        self._upload_meshes()

    def _upload_meshes(self) -> None:
        ids = [m.mesh.id for m in self.moving] + [hand.mesh_id for hand in self.hands]
        self.mesh.assign(np.array(ids, np.uint64))
        mirrored = [m.shape.orientation for m in self.moving] + [1.0] * len(self.hands)
        self.orientation.assign(np.array(mirrored, np.float32))

    def begin_here(self) -> None:
        """Start the coming step from the current poses and shapes of meshes and hands.

        Poses set between the making of a solver and its first step are not motion.
        """
        for moving in self.moving:
            before = moving.shape
            moving.shape = shape_of(moving.collider, before)
            moving.enabled = moving.collider.enabled
            same = moving.shape.vertices is before.vertices
            if not same or moving.shape.orientation != before.orientation:
                moving.first = moving.shape.vertices
                moving.mesh = _make_mesh(moving.collider, moving.shape, moving.first, self.device)
        for hand in self.hands:
            hand.begin_here()
        self._upload_meshes()

    def farthest_motion(self, ignored: float) -> tuple[list[float], list[NDArray[np.float64]]]:
        """Find how far each collider's vertices will move in the coming step, and where.

        Args:
            ignored: Motions known to be smaller than this need not be exact [m].

        Returns:
            The largest vertex motion of each collider [m], and the box that it sweeps, shape
            [2, 3]: lowest and highest corner [m].
        """
        self._targets = []
        motions = []
        boxes = []
        for moving in self.moving:
            begin, end = moving.shape, shape_of(moving.collider, moving.shape)
            self._targets.append(end)
            if not (moving.enabled and moving.collider.enabled):
                # Absent, or appearing or disappearing in place, which disturbs the clay there.
                there = end if moving.collider.enabled else begin
                corners = there.moved(there.corners)
                motions.append(float(moving.enabled != moving.collider.enabled) * BARELY)
                boxes.append(np.array([corners.min(0), corners.max(0)]))
                continue
            # In an affine motion, no point of a box moves farther than one of its corners.
            motion = longest(end.moved(begin.corners) - begin.moved(begin.corners))
            if end.vertices is not begin.vertices or motion > ignored:
                motion = longest(end.moved(end.vertices) - begin.moved(begin.vertices))
            motions.append(motion)
            swept = np.concatenate([begin.moved(begin.corners), end.moved(end.corners)])
            boxes.append(np.array([swept.min(0), swept.max(0)]))
        for hand in self.hands:
            motion, box = hand.plan()
            motions.append(motion)
            boxes.append(box)
        return motions, boxes

    def sweep(self, index: int, box: NDArray[np.float64], clay: NDArray[np.float64]) -> Sweep:
        """Find how far a collider's surface will move in the coming step, near the clay.

        Args:
            index: Index of the mesh; call `farthest_motion` first.
            box: Lowest and highest corner of the space in which it may meet clay [m], [2, 3].
            clay: Lowest and highest corner of the clay now [m], shape [2, 3].
        """
        moving, end = self.moving[index], self._targets[index]
        begin = moving.shape
        first, last = begin.moved(begin.vertices), end.moved(end.vertices)
        # From velocities: straight paths from start to end would cut through a turning wheel.
        turn = rotation_vectors_from_matrices(end.rotation @ begin.rotation.T)
        shift = end.translation - begin.translation
        change = (end.vertices - begin.vertices) if end.vertices is not begin.vertices else None
        faces = moving.collider.faces
        low = np.minimum(first, last)[faces].min(1)
        high = np.maximum(first, last)[faces].max(1)
        faces = faces[((low < box[1]) & (high > box[0])).all(1)]
        along = across = change_across = 0.0
        for shape, points in ((begin, first), (end, last)):
            motion = shift + np.cross(turn, points - shape.translation)
            if change is not None:
                change_across = longest(change)
                motion = motion + change @ shape.rotation.T
            corners = points[faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            size = np.linalg.norm(normal, axis=1)
            drive = np.abs(np.einsum("fkd,fd->fk", motion[faces], normal)).max(1, initial=0.0)
            along = max(along, float((drive / np.maximum(size, 1e-30)).max(initial=0.0)))
            # In a rigid motion, no point of a box moves faster than its fastest corner.
            inside = np.clip(box_corners(points), *clay)
            slide = longest(shift + np.cross(turn, inside - shape.translation)) + change_across
            across = max(across, min(slide, longest(motion)))
        return Sweep(along, across, float(np.linalg.norm(turn)))

    def begin_step(
        self,
        duration: float,
        substeps: int,
        motions: list[float],
        boxes: list[NDArray[np.float64]],
        teleported: list[bool],
        near: list[bool],
    ) -> None:
        """Plan the colliders' motion through the coming substeps.

        Args:
            duration: Length of the step [s].
            substeps: Number of substeps.
            motions: Distances returned by `farthest_motion` [m].
            boxes: Boxes returned by it [m].
            teleported: Whether each collider jumps to its target instead of sweeping there.
            near: Whether each collider may meet clay on the way.
        """
        targets = self._targets
        poses = np.zeros((len(motions), substeps + 1, 7), np.float32)
        poses[:, :, 6] = 1.0
        reach = np.array([0.5 * np.linalg.norm(box[1] - box[0]) for box in boxes], np.float32)
        travel = np.where(teleported, 0.0, np.array(motions) / substeps).astype(np.float32)
        turning = np.zeros(len(motions), bool)
        for index, (moving, target) in enumerate(zip(self.moving, targets, strict=True)):
            turned = target.orientation != moving.shape.orientation
            sweeps = moving.enabled and moving.collider.enabled and not teleported[index]
            moving.enabled = moving.collider.enabled
            before = moving.shape if sweeps else target
            self._update_clearance(index, present=moving.enabled, jumps=not sweeps)
            if turned:
                moving.mesh = _make_mesh(moving.collider, target, moving.first, self.device)
            poses[index] = poses_between(before, target, substeps)
            turning[index] = bool(np.ptp(poses[index, :, 3:], axis=0).max() > 1e-6)
            if not sweeps:
                travel[index] = 0.0
            elif turning[index] or self._turned[index]:
                travel[index] = 0.0
                if target.vertices is not before.vertices:
                    travel[index] = longest(target.vertices - before.vertices) / substeps
            if target.vertices is not before.vertices:
                moving.start = wp.array(before.vertices, dtype=wp.vec3, device=self.device)
                moving.end = wp.array(target.vertices, dtype=wp.vec3, device=self.device)
                moving.mesh.velocities.assign(
                    ((target.vertices - before.vertices) / substeps).astype(np.float32)
                )
            elif moving.end is not None or target.vertices is not moving.shape.vertices:
                moving.mesh.velocities.zero_()
                moving.mesh.points.assign(target.vertices.astype(np.float32))
                moving.mesh.refit()
                moving.start = moving.end = None
            reach[index] = 0.5 * box_diagonal(target.corners)
            moving.shape = target
            if turned:
                self._upload_meshes()
        self.reach.assign(reach)
        self.travel.assign(travel)
        self.turning.assign((turning | self._turned).astype(np.int32))
        self.pose_before.assign(self._poses_before)
        self._poses_before, self._turned = poses[:, -2].copy(), turning
        for hand in self.hands:
            jumps = teleported[hand.row]
            hand.begin_step(duration, jumps=jumps, near=near[hand.row])
            self._update_clearance(hand.row, present=hand.present, jumps=jumps)
        room = self.pose.shape[1]
        while room < substeps + 1:
            room *= 2
        if room != self.pose.shape[1]:
            self.pose = wp.zeros((len(motions), room), dtype=wp.transform, device=self.device)
            self.generation += 1
        filled = np.zeros((len(motions), room, 7), np.float32)
        filled[:, : substeps + 1] = poses
        self.pose.assign(filled)

    def _update_clearance(self, row: int, *, present: bool, jumps: bool) -> None:
        """Make a mesh or hand touchable or not; a jump voids its known clearance."""
        if not self.clearance.size:
            pass
        elif not present:
            # In every step, because waking resets the clearance of particles.
            self.clearance[row].fill_(OUT_OF_REACH)
        elif jumps or self._contactless[row]:
            self.clearance[row].zero_()
        self._contactless[row] = not present

    def begin_substep(self, substep: int, substeps: int, time_step: float) -> None:
        """Bring deforming meshes to the end of a substep of ``time_step`` [s]."""
        for hand in self.hands:
            hand.begin_substep(substep, substeps, time_step)
        self.substep.fill_(substep)
        for moving in self.moving:
            if moving.start is not None:
                wp.launch(
                    blend_vertices,
                    dim=len(moving.shape.vertices),
                    inputs=[moving.start, moving.end, (substep + 1) / substeps, moving.mesh.points],
                    device=self.device,
                )
                moving.mesh.refit()

    def snapshot(self) -> dict[str, NDArray]:
        """State of the colliders at the end of the last step."""
        state: dict[str, NDArray] = {
            "collider_clearance": self.clearance.numpy().copy(),
            "collider_poses_before": self._poses_before.copy(),
            "collider_turned": self._turned.copy(),
            "collider_contactless": np.array(self._contactless),
        }
        for hand in self.hands:
            state |= hand.snapshot()
        for index, moving in enumerate(self.moving):
            for name in ("rotation", "translation", "vertices", "orientation"):
                value = np.array(getattr(moving.shape, name))
                state[f"collider_{index}_{name}"] = value
        return state

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
        self.clearance.assign(state["collider_clearance"])
        self._poses_before = state["collider_poses_before"].copy()
        self._turned = state["collider_turned"].copy()
        self._contactless = state["collider_contactless"].tolist()
        for index, moving in enumerate(self.moving):
            vertices = state[f"collider_{index}_vertices"].copy()
            moving.shape = ColliderShape(
                state[f"collider_{index}_rotation"].copy(),
                state[f"collider_{index}_translation"].copy(),
                vertices,
                box_corners(vertices),
                float(state[f"collider_{index}_orientation"]),
                -1,
            )
            moving.start = moving.end = None
            moving.mesh = _make_mesh(moving.collider, moving.shape, moving.first, self.device)
            moving.enabled = not self._contactless[index]
        self._upload_meshes()
        for hand in self.hands:
            hand.restore(state)


def _make_mesh(
    collider: MeshCollider, shape: ColliderShape, first: NDArray[np.float64], device: wp.Device
) -> wp.Mesh:
    """Make the mesh on the device, with its faces flipped if the pose mirrors it.

    Args:
        collider: Its faces count.
        shape: As it is now.
        first: The vertices of which its search tree is made, shape [V, 3].
        device: Where to make it.
    """
    faces = collider.faces if shape.orientation > 0.0 else collider.faces[:, ::-1]
    mesh = wp.Mesh(
        points=wp.array(first, dtype=wp.vec3, device=device),
        indices=wp.array(np.ascontiguousarray(faces).ravel(), dtype=int, device=device),
        velocities=wp.zeros(len(first), dtype=wp.vec3, device=device),
        support_winding_number=True,
    )
    if shape.vertices is not first:
        mesh.points.assign(shape.vertices.astype(np.float32))
        mesh.refit()
    return mesh
