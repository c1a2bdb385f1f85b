# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact slots of a scene, and the passes over them."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..contact import passes_cpu
from ..contact.law import (
    DEPENETRATION_SPEED,
    MAX_CONTACTS,
    ContactPass,
    ContactSlots,
    press_all_contacts,
    rest_contacts,
    settle_all_contacts,
    wake_contacts,
)
from ..contact.search import Surroundings, find_all_contacts
from ..core.particles import ByPart, Particles
from ..scene.hand import Hand
from ..scene.scene import MeshCollider, Plane, Scene
from .meshes import MeshColliders
from .planes import PlaneColliders


class Contacts:
    """Contacts of all particles with all colliders.

    A scene without colliders allocates no slots.

    Args:
        scene: Its planes, meshes and hands are the colliders, in this order.
        particles: The clay.
        friction: Whether friction acts.
    """

    def __init__(self, scene: Scene, particles: Particles, *, friction: bool) -> None:
        self.particles = particles
        self.device = device = particles.device
        self.colliders: list[Plane | MeshCollider | Hand] = [
            *scene.planes,
            *scene.meshes,
            *scene.hands,
        ]
        self.planes = PlaneColliders(scene.planes, device) if scene.planes else None
        self.meshes = MeshColliders(scene, particles) if scene.meshes or scene.hands else None
        self.time_step = 0.0
        """Length of the last substep [s]."""
        self.plane_count = len(scene.planes)
        """Planes come first among the colliders."""
        rows = (particles.count if self.colliders else 0, MAX_CONTACTS)
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
            ("stick_stiffness", float),
            ("collider_before", int),
            ("anchor_before", wp.vec3),
            ("slide", float),
            ("slide_before", float),
            ("push", float),
            ("push_before", float),
        ):
            setattr(slots, name, wp.zeros(rows, dtype=dtype, device=device))
        soft_rows = (particles.count if scene.hands else 0, MAX_CONTACTS)
        for name, dtype in (
            ("compliance", wp.vec2),
            ("lean", wp.vec3),
            ("borne", wp.vec3),
            ("borne_before", wp.vec3),
            ("held", wp.vec3),
            ("held_before", wp.vec3),
            ("face", int),
            ("place", wp.vec2),
        ):
            setattr(slots, name, wp.zeros(soft_rows, dtype=dtype, device=device))
        slots.recovery_speed = wp.full(
            len(self.colliders), DEPENETRATION_SPEED, dtype=float, device=device
        )
        area = scene.spacing**2
        pulls = [0.0 if isinstance(c, Hand) else c.adhesion * area for c in self.colliders]
        slots.adhesion = wp.array(pulls, dtype=float, device=device)
        slots.count = wp.zeros(rows[0], dtype=int, device=device)
        slots.count_before = wp.zeros(rows[0], dtype=int, device=device)
        self.slots = slots
        materials, _ = scene.materials()
        table = np.zeros((max(len(materials), 1), max(len(self.colliders), 1)))
        if friction:
            for row, material in enumerate(materials):
                for column, collider in enumerate(self.colliders):
                    table[row, column] = math.sqrt(material.friction * collider.friction)
        self._full_friction = table
        self._grasp = np.ones(len(self.colliders))
        self._speed = np.full(len(self.colliders), DEPENETRATION_SPEED)
        self.friction = wp.array(table, dtype=float, device=device)
        """Friction of each material on each collider: the geometric mean of their coefficients."""
        around = Surroundings()
        around.plane_point = self.planes.point if self.planes else _empty(wp.vec3, device)
        around.plane_normal = self.planes.normal if self.planes else _empty(wp.vec3, device)
        around.clearance = wp.zeros((0, 0), dtype=float, device=device)
        if self.meshes:
            for name in (
                "mesh",
                "substep",
                "reach",
                "pose_before",
                "turning",
                "travel",
                "clearance",
                "first_face",
                "compliance",
            ):
                setattr(around, name, getattr(self.meshes, name))
        self._surroundings = around
        self._near = (
            ByPart(passes_cpu.make_near(particles.count, device) for _ in range(particles.parts))
            if device.is_cpu
            else None
        )
        shape = (particles.parts, len(self.colliders))
        self.impulse = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Impulse of each part on each collider in this step [N s]."""
        self._impulse_by_part = ByPart.rows(self.impulse) if self.colliders else ByPart()
        self.resting_force = wp.zeros(len(self.colliders), dtype=wp.vec3d, device=device)
        """Force of sleeping clay on each collider [N]."""
        self._slept_force = wp.zeros_like(self.resting_force)
        self.deepest = wp.zeros((particles.parts, 1), dtype=float, device=device)
        """Deepest penetration of a particle into a collider in this step, by part [m]."""

    @property
    def generation(self) -> int:
        """Changes whenever an array is replaced."""
        return self.meshes.generation if self.meshes else 0

    def rest(self, resting: wp.array, time_step: float) -> None:
        """Store the contact forces of particles that fall asleep.

        Args:
            resting: Indices of the particles.
            time_step: Length of the last substep [s].
        """
        if self.colliders:
            inputs = [resting, time_step, self.slots, self.resting_force]
            wp.launch(rest_contacts, dim=len(resting), inputs=inputs, device=self.device)

    def wake(self, woken: wp.array) -> None:
        """Resume the contacts of particles that wake, given their indices."""
        if self.colliders:
            clearance = self._surroundings.clearance
            inputs = [woken, self.time_step, self.slots, clearance, self.resting_force]
            wp.launch(wake_contacts, dim=len(woken), inputs=inputs, device=self.device)

    def begin_step(self) -> None:
        """Reset the sums of the last step."""
        self.impulse.zero_()
        self.deepest.zero_()
        # Clay that falls asleep at the end of this step is in the sums already.
        wp.copy(self._slept_force, self.resting_force)
        if self.meshes and self.meshes.hands:
            self._fade_in_hands()

    def penetrations(self) -> list[tuple[Plane | MeshCollider | Hand, float]]:
        """How deep particles lie in each collider that they touch [m], where they do."""
        count = self.slots.count.numpy()
        held = np.arange(MAX_CONTACTS) < count[:, None]
        touched = self.slots.collider.numpy()[held]
        depth = np.zeros(len(self.colliders))
        np.maximum.at(depth, touched, -self.slots.gap.numpy()[held])
        return [(self.colliders[i], float(depth[i])) for i in np.flatnonzero(depth > 0.0)]

    def force_on(self, index: int, duration: float) -> NDArray[np.float64]:
        """Mean force of the clay on a collider in the last step [N], shape [3].

        Args:
            index: Index of the collider.
            duration: Length of the step [s].
        """
        moving = self.impulse.numpy().sum(0)[index] / duration
        return moving + self._slept_force.numpy()[index]

    def _fade_in_hands(self) -> None:
        """Raise the friction and recovery speed of hands that have just appeared gradually."""
        assert self.meshes is not None
        grasp = np.ones(len(self.colliders))
        speed = np.full(len(self.colliders), DEPENETRATION_SPEED)
        for hand in self.meshes.hands:
            grasp[hand.collider] = hand.grasp
            speed[hand.collider] = hand.recovery_speed
        if not (np.array_equal(grasp, self._grasp) and np.array_equal(speed, self._speed)):
            self._grasp, self._speed = grasp, speed
            self.friction.assign((self._full_friction * grasp).astype(np.float32))
            self.slots.recovery_speed.assign(speed.astype(np.float32))

    def find(self, common: ContactPass) -> None:
        """Find the contacts of a substep; those that persist keep their anchors."""
        around = self._surroundings
        if self.meshes:
            # The array may have been replaced by a larger one.
            around.pose = self.meshes.pose
        self.launch(
            (find_all_contacts, passes_cpu.find_all_contacts),
            common,
            around,
            self.particles.position,
            self.particles.velocity,
            self.slots,
        )

    def press(
        self,
        common: ContactPass,
        change: wp.array,
        residual: wp.array,
        diagonal: wp.array,
        own_block: wp.array,
    ) -> None:
        """Add contact impulses and their tangent to the system of a substep.

        Args:
            common: The substep.
            change: Velocity changes of the last solve [m/s].
            residual: Residual impulse of each particle [N s], added to.
            diagonal: Diagonal block of the tangent for each particle [kg], added to.
            own_block: Mass and contact stiffness alone [kg], written where there may be contacts.
        """
        particles = self.particles
        self.launch(
            (press_all_contacts, passes_cpu.press_all_contacts),
            common,
            self.friction,
            particles.material,
            particles.mass,
            particles.velocity,
            change,
            self.slots,
            residual,
            diagonal,
            own_block,
        )

    def settle(self, common: ContactPass, change: wp.array) -> None:
        """Sum the impulses on colliders and move anchors, once velocities are final.

        Args:
            common: The substep.
            change: Velocity changes of the last solve [m/s].
        """
        self.launch(
            (settle_all_contacts, passes_cpu.settle_all_contacts),
            common,
            self.friction,
            self.particles.material,
            self.particles.velocity,
            change,
            self.slots,
            self._impulse_by_part,
            ByPart.rows(self.deepest),
        )

    def launch(self, kernels: tuple[wp.Kernel, wp.Kernel], *inputs: Any) -> None:
        """Run a pass with the plain kernel or the CPU's, if there are any colliders."""
        if not self.colliders:
            return
        plain, by_block = kernels
        if self._near:
            self.particles.launch_blocks(by_block, *inputs, self._near)
        else:
            self.particles.launch(plain, *inputs)

    def snapshot(self) -> dict[str, NDArray]:
        """State of the contacts and the mesh colliders."""
        if not self.colliders:
            return {}
        return {
            "contact_count": self.slots.count.numpy().copy(),
            "contact_collider": self.slots.collider.numpy().copy(),
            "contact_anchor": self.slots.anchor.numpy().copy(),
            "contact_impulse": self.slots.impulse.numpy().copy(),
            "contact_resting_force": self.resting_force.numpy().copy(),
            "contact_slide": self.slots.slide.numpy().copy(),
            "contact_push": self.slots.push.numpy().copy(),
            "contact_borne": self.slots.borne.numpy().copy(),
            "contact_held": self.slots.held.numpy().copy(),
            **(self.meshes.snapshot() if self.meshes else {}),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
        if not self.colliders:
            return
        self.slots.count.assign(state["contact_count"])
        self.slots.collider.assign(state["contact_collider"])
        self.slots.anchor.assign(state["contact_anchor"])
        self.slots.impulse.assign(state["contact_impulse"])
        self.resting_force.assign(state["contact_resting_force"])
        wp.copy(self._slept_force, self.resting_force)
        self.slots.slide.assign(state["contact_slide"])
        self.slots.push.assign(state["contact_push"])
        self.slots.borne.assign(state["contact_borne"])
        self.slots.held.assign(state["contact_held"])
        if self.meshes:
            self.meshes.restore(state)


def _empty(dtype: Any, device: wp.Device) -> wp.array:
    return wp.zeros(0, dtype=dtype, device=device)
