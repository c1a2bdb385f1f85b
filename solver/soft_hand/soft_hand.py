# SPDX-License-Identifier: GPL-3.0-or-later
"""Advances a soft hand through a step: bones, flesh, skin, and contact forces of the clay."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..contact.law import DEPENETRATION_SPEED, ContactSlots
from ..core.particles import Particles
from ..core.recording import Recordings
from ..scene.hand import Hand, HandContacts
from .bones import BonePath
from .compliance import SkinCompliance
from .contact import HandForces, carry_skin, gather_forces, make_skin
from .flesh import Flesh, yielded_part
from .hold import Hold
from .rest import flesh_rest

ITERATIONS = 6
"""Conjugate-gradient iterations in a substep."""
FRESH_EVERY = 4
"""Substeps after which stress and tangent are recomputed; in between, forces are linearized."""
ARRIVAL_TIME = 0.2
"""Time in which the grip of a hand that jumped or was lost grows to its full strength [s]."""
MAX_ARRIVAL_TIME = 1.0
"""Time after which a hand counts as arrived, even with clay still inside it [s]."""
ARRIVED_DEPTH = 0.1
"""A hand has arrived when no particle is deeper inside it than this, in spacings."""
UNLIMITED_SPEED = 1.0e6
"""A speed that is never reached [m/s]."""
SETTLING_TIME = 1.0
"""Time after which the flesh of a resting hand away from clay counts as settled [s]."""


class SoftHand:
    """One hand of a scene on the device.

    Args:
        hand: The hand.
        collider: Index of the hand among all colliders.
        row: Index of its skin among the meshes.
        first_face: Index of its first face in ``compliance``.
        compliance: Compliance of each face of all soft hands [m/N].
        travel: Largest motion of each mesh in a substep [m].
        particles: The clay.
    """

    def __init__(
        self,
        hand: Hand,
        *,
        collider: int,
        row: int,
        first_face: int,
        compliance: wp.array,
        travel: wp.array,
        particles: Particles,
    ) -> None:
        rig = hand.rig
        self.hand = hand
        self.device = device = particles.device
        self.particles = particles
        self.row = row
        self.collider = collider
        self._travel = travel
        self.path = BonePath(rig.bone_rest)
        self.path.start = hand.bones.copy()
        self.hold = None if hand.hold_stiffness is None else Hold(rig, hand.hold_stiffness)
        self.flesh = Flesh(
            rig,
            flesh_rest(rig),
            young_modulus=hand.young_modulus,
            poisson_ratio=hand.poisson_ratio,
            iterations=ITERATIONS,
            device=device,
        )
        self.skin = make_skin(rig, collider, particles.spacing, device)
        self._surface = np.flatnonzero(rig.ghost_areas > 0.0)
        self._mesh = wp.Mesh(
            points=wp.array(rig.vertices, dtype=wp.vec3, device=device),
            indices=wp.array(rig.faces.ravel(), dtype=int, device=device),
            velocities=wp.zeros(len(rig.vertices), dtype=wp.vec3, device=device),
        )
        forces = HandForces()
        forces.impulse = wp.zeros(len(self._surface), dtype=wp.vec3d, device=device)
        forces.load = wp.zeros(self.flesh.count, dtype=wp.vec3, device=device)
        forces.touched = wp.zeros(1, dtype=int, device=device)
        forces.deepest = wp.full(1, np.inf, dtype=float, device=device)
        self.forces = forces
        self.compliance = SkinCompliance(
            self.flesh,
            self.skin,
            particles,
            bones=len(rig.bone_names),
            faces=compliance[first_face : first_face + len(rig.faces)],
            single=1.0 / (hand.young_modulus * particles.spacing),
            single_joint=self.hold.compliance if self.hold else 0.0,
        )
        self._boxes = _boxes_of_bones(hand)
        self._recordings = Recordings(particles, by_part=False)
        self._arrival = ARRIVAL_TIME
        """Time since the hand jumped or appeared [s]; initially its grip is already full."""
        self._arrived = False
        self._still = 0.0
        """How long the hand has been at rest, away from clay [s]."""
        self._away = True
        """Whether the hand cannot touch clay in this step."""
        self.present = hand.tracked
        self._place()

    def begin_here(self) -> None:
        """Start from the bones' current poses, without moving there."""
        self.present = self.hand.tracked
        if self.present and not np.array_equal(self.path.start, self.hand.bones):
            self.path.start = self.hand.bones.copy()
            self._place()

    def _place(self) -> None:
        """Move the hand to the start of its path at once."""
        self.path.aim(self.path.start)
        self._move(1.0, 1.0)
        self._mesh.velocities.zero_()
        self._travel[self.row : self.row + 1].zero_()

    @property
    def mesh_id(self) -> int:
        """Warp's id of the skin's mesh."""
        return int(self._mesh.id)

    def plan(self) -> tuple[float, NDArray[np.float64]]:
        """Predict the hand's motion in this step.

        Returns:
            An upper bound on the motion of any point [m], and the corners of the box that the hand
            sweeps [m], shape [2, 3].
        """
        target = self.hand.bones if self.hand.tracked else self.path.start
        before = self._carried_boxes(self.path.start)
        after = self._carried_boxes(target)
        swept = np.concatenate([before, after])
        motion = float(np.sqrt(((after - before) ** 2).sum(1).max()))
        if self.hand.tracked != self.present:
            # A hand that appears or disappears in place must wake the clay that touches it.
            motion = max(motion, np.finfo(float).tiny)
        return motion, np.array([swept.min(0), swept.max(0)])

    def _carried_boxes(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Corners of the boxes around each bone's nodes [m]; their hull contains the flesh."""
        if self.hold:
            poses = self.hold.change @ poses
        matrices = self.path.skinning_matrices(poses)[self._boxes[0]]
        corners = np.einsum("bij,bkj->bki", matrices[:, :3, :3], self._boxes[1])
        return (corners + matrices[:, None, :3, 3]).reshape(-1, 3)

    def begin_step(self, duration: float, *, jumps: bool, near: bool) -> None:
        """Begin a step towards the bones' next poses.

        Args:
            duration: Length of the step [s].
            jumps: Whether the hand jumps to the next poses instead of sweeping there.
            near: Whether it may touch clay in this step.
        """
        returns = self.hand.tracked and not self.present
        self.present = self.hand.tracked
        self._away = not near
        forces = self.forces
        forces.impulse.zero_()
        if self._away:
            forces.deepest.zero_()
            forces.load.zero_()
        if jumps or returns:
            self.path.start = self.hand.bones.copy()
            forces.load.zero_()
            if self.hold:
                self.hold.reset()
            self._place()
            self._arrival = 0.0
            self._arrived = False
            forces.deepest.fill_(np.inf)
        else:
            target = self.hand.bones if self.present else self.path.start
            moves = not np.array_equal(target, self.path.start)
            self._still = 0.0 if moves or near else self._still + duration
            self.path.aim(target)
            self._arrival += duration
        if not self._arrived:
            clear = float(forces.deepest.numpy()[0]) < ARRIVED_DEPTH * self.particles.spacing
            self._arrived = self._arrival >= (ARRIVAL_TIME if clear else MAX_ARRIVAL_TIME)

    @property
    def grasp(self) -> float:
        """Strength of the hand's grip, 0 to 1; below 1 only shortly after it appeared or jumped."""
        return min(self._arrival / ARRIVAL_TIME, 1.0) if self.present else 0.0

    @property
    def recovery_speed(self) -> float:
        """Largest speed at which clay inside it is moved out [m/s]; unlimited once it arrived."""
        return UNLIMITED_SPEED if self._arrived else DEPENETRATION_SPEED * self.grasp

    def begin_substep(self, substep: int, substeps: int, time_step: float) -> None:
        """Move the hand to the end of a substep.

        Args:
            substep: Index of the substep.
            substeps: Number of substeps.
            time_step: Length of a substep [s].
        """
        if self._away:
            # Away from clay, only the end of the path matters.
            if substep == 0 and self._still < SETTLING_TIME:
                self._move(1.0, yielded_part(substeps * time_step))
            elif substep < 2:
                self._mesh.velocities.zero_()
                self._travel[self.row : self.row + 1].zero_()
            return
        # The tangent may be outdated, so no substep moves all the way to equilibrium.
        self._move(
            (substep + 1) / substeps, yielded_part(time_step), fresh=substep % FRESH_EVERY == 0
        )

    def end_step(self) -> None:
        """Finish the path of the step."""
        self.path.arrive()

    def _move(self, fraction: float, part: float, *, fresh: bool = True) -> None:
        poses, frames = self.path.poses(fraction)
        if self.hold:
            poses, frames = self.hold.applied(poses, frames)
        data = self.flesh.data
        data.skinning.assign(self.path.skinning_matrices(poses).astype(np.float32))
        data.bone_frame.assign(frames.astype(np.float32))
        self._recordings.run(("move", part, fresh), lambda: self._launch_move(part, fresh))
        self._mesh.refit()

    def _launch_move(self, part: float, fresh: bool) -> None:
        flesh = self.flesh
        flesh.carry()
        if fresh:
            flesh.stretch()
            flesh.stiffen()
        flesh.relax(self.forces.load, part)
        self._travel[self.row : self.row + 1].zero_()
        mesh = self._mesh
        inputs = [
            self.skin,
            flesh.data.position,
            self.row,
            mesh.points,
            mesh.velocities,
            self._travel,
        ]
        wp.launch(carry_skin, dim=len(mesh.points), inputs=inputs, device=self.device)

    def gather(self, slots: ContactSlots, time_step: float) -> None:
        """Collect the contact forces of a substep.

        Args:
            slots: The contacts.
            time_step: Length of the substep [s].
        """
        if not self._away:
            reported = 1.0 if self._arrived else 0.0
            self._recordings.run(
                ("gather", time_step, reported), lambda: self._gather(slots, time_step, reported)
            )
        if self.hold:
            self.hold.follow(self._nodes(), self.forces.load.numpy().astype(float), time_step)

    def _nodes(self) -> NDArray[np.float64]:
        """Positions of the flesh's nodes [m], shape [N, 3]."""
        return self.flesh.data.position.numpy().astype(float)

    def _gather(self, slots: ContactSlots, time_step: float, reported: float) -> None:
        particles, forces = self.particles, self.forces
        forces.load.zero_()
        forces.touched.zero_()
        forces.deepest.zero_()
        inputs = [time_step, reported, particles.resting, slots, self.skin, forces]
        wp.launch(gather_forces, dim=particles.count, inputs=inputs, device=self.device)

    def measure_compliance(self, slots: ContactSlots) -> None:
        """Measure the hand's compliance under its current contacts."""
        if not self._away and self.forces.touched.numpy()[0]:
            force = self.forces.impulse.numpy().sum(0)
            self.compliance.measure(slots, force, self._nodes(), self.hold)

    def force(self, duration: float) -> NDArray[np.float64]:
        """Mean force of the clay over a step of ``duration`` [s] [N], shape [3]."""
        return self.forces.impulse.numpy().sum(0) / duration

    def contacts(self, duration: float) -> HandContacts:
        """Ghosts and the mean forces on them over a step of ``duration`` [s]."""
        rig, surface = self.hand.rig, self._surface
        nodes = self._nodes()
        corners = nodes[rig.tetrahedra[rig.ghost_tetrahedron[surface]]]
        rest = rig.nodes[rig.tetrahedra[rig.ghost_tetrahedron[surface]]]
        deformed = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        undeformed = np.swapaxes(rest[:, 1:] - rest[:, :1], 1, 2)
        # Normals transform with the cofactor matrix of the deformation gradient.
        gradient = deformed @ np.linalg.inv(undeformed)
        first, second, third = np.moveaxis(gradient, 2, 0)
        cofactors = np.stack(
            [np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=2
        )
        normals = np.einsum("gij,gj->gi", cofactors, rig.ghost_normals[surface])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        return HandContacts(
            positions=np.einsum("gk,gkd->gd", rig.ghost_weights[surface], corners),
            normals=normals,
            areas=rig.ghost_areas[surface].copy(),
            forces=self.forces.impulse.numpy() / duration,
        )

    def snapshot(self) -> dict[str, NDArray]:
        """The state of the hand, its flesh and its forces."""
        state = {f"flesh_{name}": value for name, value in self.flesh.snapshot().items()}
        state["bones"] = self.path.start.copy()
        state["present"] = np.array(self.present)
        state["arrival"] = np.array([self._arrival, float(self._arrived)])
        state["skin"] = self._mesh.points.numpy().copy()
        for name in ("impulse", "load", "touched", "deepest"):
            state[name] = getattr(self.forces, name).numpy().copy()
        state |= self.compliance.snapshot()
        state["still"] = np.array(self._still)
        if self.hold:
            state |= {f"hold_{name}": value for name, value in self.hold.snapshot().items()}
        return {f"hand_{self.row}_{name}": value for name, value in state.items()}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore the state returned by `snapshot`."""
        own = {
            name.removeprefix(f"hand_{self.row}_"): value
            for name, value in state.items()
            if name.startswith(f"hand_{self.row}_")
        }
        self.flesh.restore(
            {name.removeprefix("flesh_"): own[name] for name in own if name.startswith("flesh_")}
        )
        self.path.start = own["bones"].copy()
        self.path.aim(self.path.start)
        self.present = bool(own["present"])
        self._arrival, self._arrived = float(own["arrival"][0]), bool(own["arrival"][1])
        if self.hold:
            self.hold.restore(
                {name.removeprefix("hold_"): own[name] for name in own if name.startswith("hold_")}
            )
        self._mesh.points.assign(own["skin"])
        self._mesh.velocities.zero_()
        self._mesh.refit()
        for name in ("impulse", "load", "touched", "deepest"):
            getattr(self.forces, name).assign(own[name])
        self.compliance.restore(own)
        self._still = float(own["still"])


def _boxes_of_bones(hand: Hand) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Bones that carry nodes, and the corners of the box around these at rest [m], [K, 8, 3]."""
    rig = hand.rig
    bones, corners = [], []
    for bone in range(len(rig.bone_names)):
        own = rig.nodes[((rig.node_bones == bone) & (rig.node_weights > 0.0)).any(1)]
        if len(own):
            low, high = own.min(0), own.max(0)
            bones.append(bone)
            corners.append(
                [[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)]
            )
    return np.array(bones), np.array(corners)
