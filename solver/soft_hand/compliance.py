# SPDX-License-Identifier: GPL-3.0-or-later
"""How much the skin of a hand gives under contacts: measured by probing, used by the particles.

Flesh yields to pressure. The implicit solve of a substep must know that the surface gives;
otherwise stiff clay and soft flesh, solved in turns, would each overshoot what the other did (a
Robin condition for partitioned coupling: Badia, Nobile and Vergara, Journal of Computational
Physics 227, 2008, doi 10.1016/j.jcp.2008.04.006). To a contact, the surface is a spring whose far
end is where the surface would be without the contact's force. How stiff it is depends on
everything that presses nearby: each contact pushes with one newton, and how far it then gives way
is its compliance.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..contact.law import ContactSlots, tangential
from ..core.particles import Particles
from ..core.recording import Recordings
from ..core.vector_units import OPTIONS
from .contact import HandSkin, part_felt, place_on_skin, whole_share
from .flesh import Flesh
from .hold import Hold

wp.set_module_options(OPTIONS)

MEMORY = 0.5
"""Weight of the old value when the compliance is measured again."""
RANGE = (0.05, 30.0)
"""Bounds of the compliance that particles use, relative to that of a single contact."""
TOLD = 0.5
"""Share of the compliance that particles use; leaving out the rest damps. With all of it, contact
would be an undamped spring; with less than an eighth, the flesh would overshoot."""


@wp.struct
class Probe:
    """Forces and responses of a probe."""

    axis: wp.array[wp.vec3]
    """Direction to probe along the skin; zero to probe normal to it."""
    load: wp.array[wp.vec3]
    """Load on nodes if each contact pushed with 1 N [N]."""
    response: wp.array[wp.vec2d]
    """Work of the probe on the motion of the skin [N m], and the squared force [N²], by bone."""


@wp.func
def probing(probe: Probe, normal: wp.vec3) -> wp.vec3:
    """Force with which a contact is probed: normal to the skin, or the axis's part along it."""
    axis = probe.axis[0]
    if wp.length_sq(axis) > 0.0:
        return tangential(axis, normal)
    return -normal


@wp.kernel(enable_backward=False)
def probe_skin(slots: ContactSlots, skin: HandSkin, probe: Probe) -> None:
    """Load nodes as if each pushing contact pushed with one newton."""
    i = wp.tid()
    for k in range(slots.count[i]):
        touches = slots.collider[i, k] == skin.collider
        if touches and wp.length_sq(slots.impulse[i, k]) > 0.0:
            face = slots.face[i, k]
            x = place_on_skin(skin, face, slots.place[i, k])
            whole = whole_share(skin, face, x)
            force = probing(probe, slots.normal[i, k])
            for at in range(skin.ghost_begin[face], skin.ghost_begin[face + 1]):
                felt = part_felt(skin, face, at, x, whole)
                if felt > 0.0:
                    corner = skin.ghost_tetrahedron[skin.ghost[at]]
                    weight = skin.ghost_weight[skin.ghost[at]]
                    for c in range(4):
                        wp.atomic_add(probe.load, corner[c], force * (felt * weight[c]))


@wp.kernel(enable_backward=False)
def measure_response(
    slots: ContactSlots, skin: HandSkin, response: wp.array[wp.vec3], probe: Probe
) -> None:
    """Sum how far contacts give way, given how far the probe moves the nodes."""
    i = wp.tid()
    for k in range(slots.count[i]):
        touches = slots.collider[i, k] == skin.collider
        if touches and wp.length_sq(slots.impulse[i, k]) > 0.0:
            face = slots.face[i, k]
            x = place_on_skin(skin, face, slots.place[i, k])
            whole = whole_share(skin, face, x)
            force = probing(probe, slots.normal[i, k])
            moved = wp.vec3()
            for at in range(skin.ghost_begin[face], skin.ghost_begin[face + 1]):
                felt = part_felt(skin, face, at, x, whole)
                if felt > 0.0:
                    corner = skin.ghost_tetrahedron[skin.ghost[at]]
                    weight = skin.ghost_weight[skin.ghost[at]]
                    for c in range(4):
                        moved += response[corner[c]] * (felt * weight[c])
            work = wp.float64(wp.dot(force, moved))
            square = wp.float64(wp.length_sq(force))
            wp.atomic_add(probe.response, skin.group[face], wp.vec2d(work, square))


@wp.kernel(enable_backward=False)
def spread_compliance(
    group: wp.array[int], by_group: wp.array[wp.vec4], compliance: wp.array[wp.vec4]
) -> None:
    """Give each face the compliance of its group."""
    i = wp.tid()
    compliance[i] = by_group[group[i]]


class SkinCompliance:
    """The compliance of the faces of a hand's skin.

    Args:
        flesh: The flesh.
        skin: The skin on it.
        particles: The clay.
        bones: Number of bones; faces of the same bone have the same compliance.
        faces: Where it is written [m/N]: flesh normal to and along the skin, joints likewise.
        lone: Rough compliance of flesh under a single particle [m/N].
        lone_joint: The same for joints [m/N].
    """

    def __init__(
        self,
        flesh: Flesh,
        skin: HandSkin,
        particles: Particles,
        *,
        bones: int,
        faces: wp.array,
        lone: float,
        lone_joint: float,
    ) -> None:
        self.flesh = flesh
        self.skin = skin
        self.particles = particles
        self.device = device = particles.device
        self._faces = faces
        self._lone = TOLD * np.array((lone, lone, lone_joint, lone_joint))
        self._told = np.tile(self._lone, (bones, 1))
        self._by_bone = wp.zeros(bones, dtype=wp.vec4, device=device)
        self._turn = 0
        probe = Probe()
        probe.axis = wp.zeros(1, dtype=wp.vec3, device=device)
        probe.load = wp.zeros(flesh.count, dtype=wp.vec3, device=device)
        probe.response = wp.zeros(bones, dtype=wp.vec2d, device=device)
        self._probe = probe
        self._recordings = Recordings(particles, by_part=False)
        self._tell()

    def learn(
        self,
        slots: ContactSlots,
        force: NDArray[np.float64],
        nodes: NDArray[np.float64],
        hold: Hold | None,
    ) -> None:
        """Measure again, every second time: normal to the skin, and along it in two directions.

        Args:
            slots: The contacts.
            force: On the whole hand, in any unit: only its direction counts.
            nodes: Positions of the nodes of the flesh [m], shape [N, 3].
            hold: The springs of the joints.
        """
        self._turn = (self._turn + 1) % 8
        if self._turn % 2:
            return
        along = self._turn // 2 % 2
        axis = _across(force, other=self._turn == 6) if along else np.zeros(3)
        self._probe.axis.assign(axis.astype(np.float32)[None])
        self._recordings.run("probe", lambda: self._press(slots))
        response = self.flesh.solve_data.change
        self._take_in(slots, response, along)
        if hold:
            load = self._probe.load.numpy().astype(float)
            response.assign(hold.response(nodes, load).astype(np.float32))
            self._take_in(slots, response, 2 + along)
        self._tell()

    def _press(self, slots: ContactSlots) -> None:
        """Solve for the flesh's response when each contact pushes with one newton."""
        probe = self._probe
        probe.load.zero_()
        self._launch(probe_skin, slots, self.skin, probe)
        self.flesh.respond(probe.load)

    def _take_in(self, slots: ContactSlots, response: wp.array, component: int) -> None:
        """Blend in the probe's displacement of nodes [m], for one of the four compliances."""
        probe = self._probe
        probe.response.zero_()
        self._launch(measure_response, slots, self.skin, response, probe)
        work, square = probe.response.numpy().T
        known = square > 1e-9
        found = TOLD * np.divide(work, square, out=np.ones_like(work), where=known)
        lone = self._lone[component]
        found = np.clip(found, RANGE[0] * lone, RANGE[1] * lone)
        told = self._told[:, component]
        told[:] = np.where(known, told + (1.0 - MEMORY) * (found - told), lone)

    def _launch(self, kernel: wp.Kernel, *inputs: Any) -> None:
        count = self.particles.count
        wp.launch(kernel, dim=count, inputs=list(inputs), device=self.device)

    def _tell(self) -> None:
        self._by_bone.assign(self._told.astype(np.float32))
        inputs = [self.skin.group, self._by_bone, self._faces]
        wp.launch(spread_compliance, dim=len(self._faces), inputs=inputs, device=self.device)

    def snapshot(self) -> dict[str, NDArray]:
        """The compliances, and which is measured next."""
        return {"told": self._told.copy(), "turn": np.array(self._turn)}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Return to the state that `snapshot` gave."""
        self._told = state["told"].copy()
        self._turn = int(state["turn"])
        self._tell()


def _across(force: NDArray[np.float64], *, other: bool) -> NDArray[np.float64]:
    """One of two unit vectors perpendicular to a force, shape [3]."""
    if not force.any():
        force = np.array((0.0, 0.0, 1.0))
    first = np.cross(force, np.eye(3)[np.abs(force).argmin()])
    axis = np.cross(force, first) if other else first
    return axis / np.linalg.norm(axis)
