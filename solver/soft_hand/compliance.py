# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the compliance of a hand's skin under contacts, for the solve of the particles.

Flesh yields to pressure. The implicit solve of a substep must account for the surface's compliance;
otherwise stiff clay and soft flesh, solved alternately, would overshoot each other's changes (a
Robin condition for partitioned coupling: Badia, Nobile and Vergara, Journal of Computational
Physics 227, 2008, doi 10.1016/j.jcp.2008.04.006). For a contact, the surface is a spring whose far
end is where the surface would be without the contact's force. Its stiffness depends on all other
contacts nearby. It is measured by applying one newton at every contact: the resulting displacement
of a contact is its compliance.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..contact.law import ContactSlots, tangential
from ..core.particles import Particles
from ..core.recording import Recordings
from ..core.vector_units import OPTIONS
from .contact import HandSkin, contact_share, point_on_skin, total_share
from .flesh import Flesh
from .hold import Hold

wp.set_module_options(OPTIONS)

MEMORY = 0.5
"""Weight of the old value when the compliance is measured again."""
RANGE = (0.05, 30.0)
"""Bounds of the compliance that particles use, relative to that of a single contact."""
USED_SHARE = 0.5
"""Share of the measured compliance that particles use. A share below one adds damping; with the
full compliance, contact would be an undamped spring, and below an eighth the flesh would
overshoot."""


@wp.struct
class Probe:
    """Forces and responses of a probe."""

    axis: wp.array[wp.vec3]
    """Direction to probe along the skin; zero to probe normal to the skin."""
    load: wp.array[wp.vec3]
    """Load on each node if each contact pushes with 1 N [N]."""
    response: wp.array[wp.vec2d]
    """For each bone, work of the probe's forces [N m], and their sum of squares [N²]."""


@wp.func
def probe_force(probe: Probe, normal: wp.vec3) -> wp.vec3:
    """Force of the probe at a contact: normal to the skin, or the tangential part of the axis."""
    axis = probe.axis[0]
    if wp.length_sq(axis) > 0.0:
        return tangential(axis, normal)
    return -normal


@wp.kernel(enable_backward=False)
def probe_skin(slots: ContactSlots, skin: HandSkin, probe: Probe) -> None:
    """Load the nodes as if each pushing contact pushed with one newton."""
    i = wp.tid()
    for k in range(slots.count[i]):
        touches = slots.collider[i, k] == skin.collider
        if touches and wp.length_sq(slots.impulse[i, k]) > 0.0:
            face = slots.face[i, k]
            x = point_on_skin(skin, face, slots.place[i, k])
            total = total_share(skin, face, x)
            force = probe_force(probe, slots.normal[i, k])
            for at in range(skin.ghost_begin[face], skin.ghost_begin[face + 1]):
                share = contact_share(skin, face, at, x, total)
                if share > 0.0:
                    corner = skin.ghost_tetrahedron[skin.ghost[at]]
                    weight = skin.ghost_weight[skin.ghost[at]]
                    for c in range(4):
                        wp.atomic_add(probe.load, corner[c], force * (share * weight[c]))


@wp.kernel(enable_backward=False)
def measure_response(
    slots: ContactSlots, skin: HandSkin, response: wp.array[wp.vec3], probe: Probe
) -> None:
    """Sum the work of the probe at the contacts, given the displacements of the nodes."""
    i = wp.tid()
    for k in range(slots.count[i]):
        touches = slots.collider[i, k] == skin.collider
        if touches and wp.length_sq(slots.impulse[i, k]) > 0.0:
            face = slots.face[i, k]
            x = point_on_skin(skin, face, slots.place[i, k])
            total = total_share(skin, face, x)
            force = probe_force(probe, slots.normal[i, k])
            displacement = wp.vec3()
            for at in range(skin.ghost_begin[face], skin.ghost_begin[face + 1]):
                share = contact_share(skin, face, at, x, total)
                if share > 0.0:
                    corner = skin.ghost_tetrahedron[skin.ghost[at]]
                    weight = skin.ghost_weight[skin.ghost[at]]
                    for c in range(4):
                        displacement += response[corner[c]] * (share * weight[c])
            work = wp.float64(wp.dot(force, displacement))
            square = wp.float64(wp.length_sq(force))
            wp.atomic_add(probe.response, skin.group[face], wp.vec2d(work, square))


@wp.kernel(enable_backward=False)
def spread_compliance(
    group: wp.array[int], by_group: wp.array[wp.vec4], compliance: wp.array[wp.vec4]
) -> None:
    """Copy to each face the compliance of its group."""
    i = wp.tid()
    compliance[i] = by_group[group[i]]


class SkinCompliance:
    """The compliance of the faces of a hand's skin.

    Args:
        flesh: The flesh.
        skin: Its skin.
        particles: The clay.
        bones: Number of bones; faces of the same bone have the same compliance.
        faces: Receives the compliance of each face [m/N]: that of the flesh normal to and along
            the skin, then that of the joints.
        single: Approximate compliance of flesh under a single particle [m/N].
        single_joint: The same for joints [m/N].
    """

    def __init__(
        self,
        flesh: Flesh,
        skin: HandSkin,
        particles: Particles,
        *,
        bones: int,
        faces: wp.array,
        single: float,
        single_joint: float,
    ) -> None:
        self.flesh = flesh
        self.skin = skin
        self.particles = particles
        self.device = device = particles.device
        self._faces = faces
        self._single = USED_SHARE * np.array((single, single, single_joint, single_joint))
        self._used = np.tile(self._single, (bones, 1))
        self._by_bone = wp.zeros(bones, dtype=wp.vec4, device=device)
        self._phase = 0
        probe = Probe()
        probe.axis = wp.zeros(1, dtype=wp.vec3, device=device)
        probe.load = wp.zeros(flesh.count, dtype=wp.vec3, device=device)
        probe.response = wp.zeros(bones, dtype=wp.vec2d, device=device)
        self._probe = probe
        self._recordings = Recordings(particles, by_part=False)
        self._write_faces()

    def measure(
        self,
        slots: ContactSlots,
        force: NDArray[np.float64],
        nodes: NDArray[np.float64],
        hold: Hold | None,
    ) -> None:
        """Update the compliance in every second call, alternating between three directions.

        Every other update probes normal to the skin, the rest along it in two directions.

        Args:
            slots: The contacts.
            force: Direction of the total force on the hand, in any unit, shape [3].
            nodes: Positions of the flesh's nodes [m], shape [N, 3].
            hold: The springs of the joints.
        """
        self._phase = (self._phase + 1) % 8
        if self._phase % 2:
            return
        along = self._phase // 2 % 2
        axis = _across(force, other=self._phase == 6) if along else np.zeros(3)
        self._probe.axis.assign(axis.astype(np.float32)[None])
        self._recordings.run("probe", lambda: self._apply_probe(slots))
        response = self.flesh.solve_data.change
        self._update(slots, response, along)
        if hold:
            load = self._probe.load.numpy().astype(float)
            response.assign(hold.response(nodes, load).astype(np.float32))
            self._update(slots, response, 2 + along)
        self._write_faces()

    def _apply_probe(self, slots: ContactSlots) -> None:
        """Compute the flesh's response if each contact pushes with one newton."""
        probe = self._probe
        probe.load.zero_()
        self._launch(probe_skin, slots, self.skin, probe)
        self.flesh.respond(probe.load)

    def _update(self, slots: ContactSlots, response: wp.array, component: int) -> None:
        """Update one of the four compliances from the probe's displacements of nodes [m]."""
        probe = self._probe
        probe.response.zero_()
        self._launch(measure_response, slots, self.skin, response, probe)
        work, square = probe.response.numpy().T
        known = square > 1e-9
        measured = USED_SHARE * np.divide(work, square, out=np.ones_like(work), where=known)
        single = self._single[component]
        measured = np.clip(measured, RANGE[0] * single, RANGE[1] * single)
        used = self._used[:, component]
        used[:] = np.where(known, used + (1.0 - MEMORY) * (measured - used), single)

    def _launch(self, kernel: wp.Kernel, *inputs: Any) -> None:
        count = self.particles.count
        wp.launch(kernel, dim=count, inputs=list(inputs), device=self.device)

    def _write_faces(self) -> None:
        self._by_bone.assign(self._used.astype(np.float32))
        inputs = [self.skin.group, self._by_bone, self._faces]
        wp.launch(spread_compliance, dim=len(self._faces), inputs=inputs, device=self.device)

    def snapshot(self) -> dict[str, NDArray]:
        """The compliances, and the phase of their measurement."""
        return {"told": self._used.copy(), "turn": np.array(self._phase)}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore the state returned by `snapshot`."""
        self._used = state["told"].copy()
        self._phase = int(state["turn"])
        self._write_faces()


def _across(force: NDArray[np.float64], *, other: bool) -> NDArray[np.float64]:
    """One of two unit vectors perpendicular to a force, shape [3]."""
    if not force.any():
        force = np.array((0.0, 0.0, 1.0))
    first = np.cross(force, np.eye(3)[np.abs(force).argmin()])
    axis = np.cross(force, first) if other else first
    return axis / np.linalg.norm(axis)
