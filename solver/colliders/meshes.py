# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh colliders and hands on the device, and their way through a step."""

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
"""A motion that disturbs clay and asks for no substeps [m]."""


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


@dataclass
class _MovingMesh:
    """One mesh collider on the device, and where it stood at the end of the last step."""

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
    """Whether the clay met it in the last step."""


class Sweep(NamedTuple):
    """How a collider moves in a step. A wheel that turns, or a plate drawn along itself, meets
    nothing on its way."""

    along: float
    """Way of its surface along the normals [m]."""
    across: float
    """Way in any direction of what is where clay is [m]."""
    turn: float
    """Angle [rad]."""


class MeshColliders:
    """All mesh colliders and hands of a scene.

    A collider's pose is split into a rigid part, which moves the query point, and a stretch,
    which is applied to the vertices; only a change of shape refits the mesh. The skin of a hand
    stands in the world as it is.

    Args:
        scene: The colliders, at their poses of now.
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
        """Which of a step's substeps is under way; on the device, so that it can be recorded."""
        self.clearance = wp.zeros((count, particles.count), dtype=float, device=device)
        self._targets: list[ColliderShape] = []
        faces = [len(hand.rig.faces) for hand in scene.hands]
        begin = np.concatenate([[0], np.cumsum(faces)]).astype(int)
        first_face = [-1] * len(scene.meshes) + begin[:-1].tolist()
        self.first_face = wp.array(first_face, dtype=int, device=device)
        """Where the faces of each mesh begin in ``compliance``; -1 for a rigid one."""
        self.compliance = wp.zeros(int(begin[-1]), dtype=wp.vec4, device=device)
        """How much flesh and joints give to a contact at each face of the hands [m/N]."""
        self.hands = [
            SoftHand(
                hand,
                collider=len(scene.planes) + len(scene.meshes) + which,
                row=len(scene.meshes) + which,
                first_face=int(begin[which]),
                compliance=self.compliance,
                travel=self.travel,
                particles=particles,
            )
            for which, hand in enumerate(scene.hands)
        ]
        self._contactless = [False] * count
        """Meshes and hands that nothing could touch in the last step."""
        self.mesh = wp.zeros(count, dtype=wp.uint64, device=device)
        self._tell_meshes()

    def _tell_meshes(self) -> None:
        ids = [m.mesh.id for m in self.moving] + [hand.mesh_id for hand in self.hands]
        self.mesh.assign(np.array(ids, np.uint64))
        mirrored = [m.shape.orientation for m in self.moving] + [1.0] * len(self.hands)
        self.orientation.assign(np.array(mirrored, np.float32))

    def begin_here(self) -> None:
        """Take the poses and shapes of now for where meshes and hands have been all along.

        Whoever makes a solver and then sets where a tool is means that it begins there.
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
        self._tell_meshes()

    def farthest_motion(self, ignored: float) -> tuple[list[float], list[NDArray[np.float64]]]:
        """How far any vertex of each collider is going to move in this step, and where.

        Args:
            ignored: Motions that are surely less than this need not be exact [m].

        Returns:
            Distances [m], and the boxes that the colliders sweep, shape [2, 3] each: lowest and
            highest corner [m].
        """
        self._targets = []
        motions = []
        boxes = []
        for moving in self.moving:
            begin, end = moving.shape, shape_of(moving.collider, moving.shape)
            self._targets.append(end)
            if not (moving.enabled and moving.collider.enabled):
                # It is nowhere, or comes or goes where it is: that disturbs what it touches there.
                there = end if moving.collider.enabled else begin
                corners = there.moved(there.corners)
                motions.append(float(moving.enabled != moving.collider.enabled) * BARELY)
                boxes.append(np.array([corners.min(0), corners.max(0)]))
                continue
            # An affine motion takes no point of a box farther than the farthest corner.
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

    def sweep(self, which: int, box: NDArray[np.float64], clay: NDArray[np.float64]) -> Sweep:
        """How a collider's surface is going to move in this step, where it matters.

        Args:
            which: The collider; `farthest_motion` comes first.
            box: Lowest and highest corner of where it may meet clay [m], shape [2, 3].
            clay: Those of where clay is now [m], shape [2, 3].
        """
        moving, end = self.moving[which], self._targets[which]
        begin = moving.shape
        first, last = begin.moved(begin.vertices), end.moved(end.vertices)
        # By its velocity: from end to end the rim of a wheel would seem to cut through it.
        turn = rotation_vectors_from_matrices(end.rotation @ begin.rotation.T)
        shift = end.translation - begin.translation
        change = (end.vertices - begin.vertices) if end.vertices is not begin.vertices else None
        faces = moving.collider.faces
        low = np.minimum(first, last)[faces].min(1)
        high = np.maximum(first, last)[faces].max(1)
        faces = faces[((low < box[1]) & (high > box[0])).all(1)]
        along = across = change_across = 0.0
        for shape, points in ((begin, first), (end, last)):
            way = shift + np.cross(turn, points - shape.translation)
            if change is not None:
                change_across = longest(change)
                way = way + change @ shape.rotation.T
            corners = points[faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            size = np.linalg.norm(normal, axis=1)
            drive = np.abs(np.einsum("fkd,fd->fk", way[faces], normal)).max(1, initial=0.0)
            along = max(along, float((drive / np.maximum(size, 1e-30)).max(initial=0.0)))
            # What is rigid moves no faster anywhere in a box than at its fastest corner.
            inside = np.clip(box_corners(points), *clay)
            slide = longest(shift + np.cross(turn, inside - shape.translation)) + change_across
            across = max(across, min(slide, longest(way)))
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
        """Lay out the colliders' way through the coming substeps.

        Args:
            duration: Of the step [s].
            substeps: Number of substeps.
            motions: What `farthest_motion` gave [m].
            boxes: What it gave [m].
            teleported: Colliders that jump to their target at once instead of sweeping there.
            near: Colliders that may meet clay on the way.
        """
        targets = self._targets
        poses = np.zeros((len(motions), substeps + 1, 7), np.float32)
        poses[:, :, 6] = 1.0
        reach = np.array([0.5 * np.linalg.norm(box[1] - box[0]) for box in boxes], np.float32)
        travel = np.where(teleported, 0.0, np.array(motions) / substeps).astype(np.float32)
        turning = np.zeros(len(motions), bool)
        for which, (moving, target) in enumerate(zip(self.moving, targets, strict=True)):
            turned = target.orientation != moving.shape.orientation
            sweeps = moving.enabled and moving.collider.enabled and not teleported[which]
            moving.enabled = moving.collider.enabled
            before = moving.shape if sweeps else target
            self._show(which, present=moving.enabled, jumps=not sweeps)
            if turned:
                moving.mesh = _make_mesh(moving.collider, target, moving.first, self.device)
            poses[which] = poses_between(before, target, substeps)
            turning[which] = bool(np.ptp(poses[which, :, 3:], axis=0).max() > 1e-6)
            if not sweeps:
                travel[which] = 0.0
            elif turning[which] or self._turned[which]:
                travel[which] = 0.0
                if target.vertices is not before.vertices:
                    travel[which] = longest(target.vertices - before.vertices) / substeps
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
            reach[which] = 0.5 * box_diagonal(target.corners)
            moving.shape = target
            if turned:
                self._tell_meshes()
        self.reach.assign(reach)
        self.travel.assign(travel)
        self.turning.assign((turning | self._turned).astype(np.int32))
        self.pose_before.assign(self._poses_before)
        self._poses_before, self._turned = poses[:, -2].copy(), turning
        for hand in self.hands:
            jumps = teleported[hand.row]
            hand.begin_step(duration, jumps=jumps, near=near[hand.row])
            self._show(hand.row, present=hand.present, jumps=jumps)
        room = self.pose.shape[1]
        while room < substeps + 1:
            room *= 2
        if room != self.pose.shape[1]:
            self.pose = wp.zeros((len(motions), room), dtype=wp.transform, device=self.device)
            self.generation += 1
        filled = np.zeros((len(motions), room, 7), np.float32)
        filled[:, : substeps + 1] = poses
        self.pose.assign(filled)

    def _show(self, row: int, *, present: bool, jumps: bool) -> None:
        """Let clay touch a mesh or hand or not; one that jumps may be anywhere now."""
        if not self.clearance.size:
            pass
        elif not present:
            # In every step: clay that wakes has forgotten how far off everything is.
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
        """Where the colliders stood at the end of the last step."""
        state: dict[str, NDArray] = {
            "collider_clearance": self.clearance.numpy().copy(),
            "collider_poses_before": self._poses_before.copy(),
            "collider_turned": self._turned.copy(),
            "collider_contactless": np.array(self._contactless),
        }
        for hand in self.hands:
            state |= hand.snapshot()
        for which, moving in enumerate(self.moving):
            for name in ("rotation", "translation", "vertices", "orientation"):
                value = np.array(getattr(moving.shape, name))
                state[f"collider_{which}_{name}"] = value
        return state

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        self.clearance.assign(state["collider_clearance"])
        self._poses_before = state["collider_poses_before"].copy()
        self._turned = state["collider_turned"].copy()
        self._contactless = state["collider_contactless"].tolist()
        for which, moving in enumerate(self.moving):
            vertices = state[f"collider_{which}_vertices"].copy()
            moving.shape = ColliderShape(
                state[f"collider_{which}_rotation"].copy(),
                state[f"collider_{which}_translation"].copy(),
                vertices,
                box_corners(vertices),
                float(state[f"collider_{which}_orientation"]),
                -1,
            )
            moving.start = moving.end = None
            moving.mesh = _make_mesh(moving.collider, moving.shape, moving.first, self.device)
            moving.enabled = not self._contactless[which]
        self._tell_meshes()
        for hand in self.hands:
            hand.restore(state)


def _make_mesh(
    collider: MeshCollider, shape: ColliderShape, first: NDArray[np.float64], device: wp.Device
) -> wp.Mesh:
    """The mesh on the device; a mirrored one is turned outside out again.

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
