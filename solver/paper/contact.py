# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact and friction of the paper's clay (section III-D): ghost particles and sliding anchors.

Each constraint is impenetrability against one ghost particle: n · (x - g) >= R with the ghost's
normal, so that it only repels outward, or the distance |x - g| >= R where the particle is beside
the ghost, as at the rim of a face. An infinite plane has a ghost directly below every particle. R
is half the spacing: the ball of a resting particle touches the surface. Friction pulls a particle
to its anchor, by no more than μ times the projection by impenetrability.

Where the paper is silent:

- Friction is limited over the sum of a substep's iterations. Limited in each iteration, it would
  vanish as impenetrability converges.
- A new anchor lies where the particle met the surface, not at the ghost, which may be a ghost
  spacing away. It moves with the surface, and keeps its place when another ghost takes over.
- Particles that start a substep inside are moved out no faster than `DEPENETRATION_SPEED`.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..colliders.contacts import Contacts
from ..contact.law import DEPENETRATION_SPEED, ContactPass
from ..core.particles import Particles
from ..hand.ghosts import GhostMesh, rasterize_ghosts
from .contact_search import (
    ANCHOR_MEMORY,
    MAX_CONSTRAINTS,
    GhostConstraints,
    find_ghost_contacts,
    find_plane_constraints,
)

GHOST_SPACING = 1.0
"""Distance between ghosts, in particle radii."""
REACH = 3.0
"""Search radius for ghosts around a particle's predicted position, in particle radii."""


@wp.kernel(enable_backward=False)
def project_contacts(
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    displacement: wp.array[wp.vec3],
    slots: GhostConstraints,
) -> None:
    """Project each particle out of its ghosts, then towards its anchors."""
    i = wp.tid()
    moved = displacement[i]
    for k in range(slots.count[i]):
        n = slots.normal[i, k]
        # A ball that already lay inside is moved only part of the way out.
        start = slots.gap[i, k] + wp.dot(slots.surface_motion[i, k], n)
        allowed = wp.min(start + DEPENETRATION_SPEED * common.time_step, 0.0)
        depth = allowed - slots.gap[i, k] - wp.dot(moved, n)
        if depth > 0.0:
            moved += n * depth
            slots.push[i, k] = slots.push[i, k] + depth
        push = slots.push[i, k]
        if push > 0.0:
            slip = moved - slots.surface_motion[i, k]
            slip = slip - n * wp.dot(slip, n) + slots.stretch[i, k]
            drag = slots.drag[i, k] - slip
            limit = friction[material[i], slots.collider[i, k]] * push
            length = wp.length(drag)
            if length > limit:
                drag = drag * (limit / length)
            moved += drag - slots.drag[i, k]
            slots.drag[i, k] = drag
    displacement[i] = moved


@wp.kernel(enable_backward=False)
def settle_ghost_contacts(
    common: ContactPass,
    material: wp.array[int],
    mass: wp.array[float],
    displacement: wp.array[wp.vec3],
    slots: GhostConstraints,
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
) -> None:
    """Sum the impulses on colliders (eq. 6), and slide anchors.

    An anchor ends no farther from its particle than friction moved the particle in this substep.
    """
    i = wp.tid()
    for k in range(slots.count[i]):
        n = slots.normal[i, k]
        push = slots.push[i, k]
        slip = displacement[i] - slots.surface_motion[i, k]
        stretch = slip - n * wp.dot(slip, n) + slots.stretch[i, k]
        if push > 0.0:
            applied = n * push + slots.drag[i, k]
            wp.atomic_add(
                impulse,
                slots.collider[i, k],
                wp.vec3d(applied * (-mass[material[i]] / common.time_step)),
            )
            length = wp.length(stretch)
            drag = wp.length(slots.drag[i, k])
            if length > drag:
                stretch = stretch * (drag / length)
            slots.idle[i, k] = 0
        else:
            idle = slots.idle[i, k] + 1
            slots.idle[i, k] = idle
            if idle >= ANCHOR_MEMORY:
                stretch = wp.vec3()
        slots.stretch[i, k] = stretch
        wp.atomic_max(deepest, 0, -slots.gap[i, k] - wp.dot(displacement[i], n))


class PaperContacts:
    """Impenetrability and friction of all particles with all colliders.

    Args:
        particles: The clay.
        contacts: The colliders, their motion, and the sums of impulses.
    """

    def __init__(self, particles: Particles, contacts: Contacts) -> None:
        self.particles = particles
        self.contacts = contacts
        self.device = device = particles.device
        radius = 0.5 * particles.spacing
        self.reach = REACH * radius
        self.ghosts: list[GhostMesh] = []
        self._carried: list[NDArray | None] = []
        if contacts.meshes:
            for moving in contacts.meshes.moving:
                ghosts = rasterize_ghosts(
                    moving.shape.vertices, moving.collider.faces, GHOST_SPACING * radius
                )
                self.ghosts.append(GhostMesh(ghosts, self.reach, device))
                self._carried.append(None)
        rows = (particles.count if contacts.colliders else 0, MAX_CONSTRAINTS)
        slots = GhostConstraints()
        for name, dtype in (
            ("collider", int),
            ("ghost", int),
            ("normal", wp.vec3),
            ("gap", float),
            ("surface_motion", wp.vec3),
            ("stretch", wp.vec3),
            ("idle", int),
            ("push", float),
            ("drag", wp.vec3),
            ("collider_before", int),
            ("normal_before", wp.vec3),
            ("stretch_before", wp.vec3),
            ("idle_before", int),
        ):
            setattr(slots, name, wp.zeros(rows, dtype=dtype, device=device))
        slots.count = wp.zeros(rows[0], dtype=int, device=device)
        slots.count_before = wp.zeros(rows[0], dtype=int, device=device)
        self.slots = slots

    def find(self, common: ContactPass, displacement: wp.array) -> None:
        """Find the constraints of a substep; those that persist keep their anchors.

        Args:
            common: The substep.
            displacement: Displacements predicted without constraints [m].
        """
        contacts, slots = self.contacts, self.slots
        if not contacts.colliders:
            return
        for name in ("count", "collider", "normal", "stretch", "idle"):
            wp.copy(getattr(slots, f"{name}_before"), getattr(slots, name))
        slots.count.zero_()
        motion = [self.particles.position, displacement]
        if contacts.meshes:
            self._carry_ghosts()
            first = len(contacts.colliders) - len(self.ghosts)
            for row, ghosts in enumerate(self.ghosts):
                if not contacts.meshes.moving[row].enabled:
                    continue
                wp.launch(
                    find_ghost_contacts,
                    dim=self.particles.count,
                    inputs=[
                        common,
                        contacts.meshes.substep,
                        first + row,
                        row,
                        contacts.meshes.pose,
                        self.reach,
                        ghosts.grid.id,
                        ghosts.position,
                        ghosts.normal,
                        ghosts.drift,
                        *motion,
                        slots,
                    ],
                    device=self.device,
                )
        if contacts.planes:
            wp.launch(
                find_plane_constraints,
                dim=self.particles.count,
                inputs=[common, contacts.planes.point, contacts.planes.normal, *motion, slots],
                device=self.device,
            )

    def _carry_ghosts(self) -> None:
        """Move ghosts of meshes that changed shape; rigid motion is in the pose."""
        meshes = self.contacts.meshes
        assert meshes is not None
        for row, (ghosts, moving) in enumerate(zip(self.ghosts, meshes.moving, strict=True)):
            deforms = moving.start is not None
            if deforms or self._carried[row] is not moving.shape.vertices:
                ghosts.carry(moving.mesh, meshes.orientation, row)
                # The step after a change of shape puts the vertices exactly in place.
                self._carried[row] = None if deforms else moving.shape.vertices

    def project(self, common: ContactPass, displacement: wp.array) -> None:
        """Solve once for impenetrability and friction, in place.

        Args:
            common: The substep.
            displacement: Displacements since the start of the substep [m].
        """
        if not self.contacts.colliders:
            return
        particles = self.particles
        wp.launch(
            project_contacts,
            dim=particles.count,
            inputs=[
                common,
                self.contacts.friction,
                particles.material,
                displacement,
                self.slots,
            ],
            device=self.device,
        )

    def settle(self, common: ContactPass, displacement: wp.array) -> None:
        """Sum the impulses on colliders and slide anchors, once the substep is solved."""
        if not self.contacts.colliders:
            return
        particles = self.particles
        wp.launch(
            settle_ghost_contacts,
            dim=particles.count,
            inputs=[
                common,
                particles.material,
                particles.mass,
                displacement,
                self.slots,
                self.contacts.impulse[0],
                self.contacts.deepest[0],
            ],
            device=self.device,
        )

    def snapshot(self) -> dict[str, NDArray]:
        """Anchors and their contacts."""
        if not self.contacts.colliders:
            return {}
        names = ("count", "collider", "normal", "stretch", "idle")
        return {f"anchor_{name}": getattr(self.slots, name).numpy().copy() for name in names}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
        if not self.contacts.colliders:
            return
        for name in ("count", "collider", "normal", "stretch", "idle"):
            getattr(self.slots, name).assign(np.asarray(state[f"anchor_{name}"]))
        self._carried = [None] * len(self.ghosts)
