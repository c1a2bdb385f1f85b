# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfers forces of contacts on the skin of a soft hand to its ghosts and the flesh's nodes.

A particle presses with its whole face: its force is distributed to the ghosts around the point of
contact, most to the nearest, and from each ghost to the four nodes of its tetrahedron (Barreiro,
Torres and Otaduy, WHC 2021, section III-D). Forces on ghosts and on nodes both sum to the reaction
to the forces on the particles.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..contact.law import ContactSlots
from ..core.vector_units import OPTIONS
from ..hand.rig import HandRig

wp.set_module_options(OPTIONS)

GHOST_REACH = 0.6
"""Radius around a contact in which ghosts feel it, in spacings: that of a particle's face."""
_CHUNK_SIZE = 256
"""Number of faces compared with ghosts at once, to limit memory."""


@wp.struct
class HandSkin:
    """The skin of a hand, and the ghosts on it."""

    collider: int
    """Index of the hand among all colliders."""
    face: wp.array[wp.vec3i]
    rest: wp.array[wp.vec3]
    """Vertices at rest [m]."""
    tetrahedron: wp.array[wp.vec4i]
    """Nodes that carry each vertex."""
    weight: wp.array[wp.vec4]
    """Barycentric coordinates of each vertex."""
    group: wp.array[int]
    """Bone that each face belongs to."""
    ghost_begin: wp.array[int]
    """Index of the first ghost of each face in ``ghost``."""
    ghost: wp.array[int]
    """Ghosts around faces, face by face."""
    ghost_rest: wp.array[wp.vec3]
    """Ghosts at rest [m]."""
    ghost_reach: float
    """Radius around a contact in which ghosts feel it [m]."""
    ghost_tetrahedron: wp.array[wp.vec4i]
    """Nodes that carry each ghost."""
    ghost_weight: wp.array[wp.vec4]
    """Barycentric coordinates of each ghost."""


@wp.struct
class HandForces:
    """Forces of the clay on a hand."""

    impulse: wp.array[wp.vec3d]
    """Impulse on each ghost in this step [N s]."""
    load: wp.array[wp.vec3]
    """Force on each node in the last substep [N]."""
    touched: wp.array[int]
    """Number of pushing contacts in the last substep."""
    deepest: wp.array[float]
    """Deepest penetration of a particle in the last substep [m]."""


@wp.kernel(enable_backward=False)
def carry_skin(
    skin: HandSkin,
    position: wp.array[wp.vec3],
    row: int,
    points: wp.array[wp.vec3],
    motion: wp.array[wp.vec3],
    travel: wp.array[float],
) -> None:
    """Move the skin with the nodes, and record the largest motion."""
    i = wp.tid()
    corner = skin.tetrahedron[i]
    weight = skin.weight[i]
    x = wp.vec3()
    for k in range(4):
        x += position[corner[k]] * weight[k]
    moved = x - points[i]
    motion[i] = moved
    points[i] = x
    wp.atomic_max(travel, row, wp.length(moved))


@wp.func
def point_on_skin(skin: HandSkin, face: int, place: wp.vec2) -> wp.vec3:
    """The point with barycentric coordinates ``place`` on a face of the skin at rest [m]."""
    corner = skin.face[face]
    last = 1.0 - place[0] - place[1]
    return (
        skin.rest[corner[0]] * place[0]
        + skin.rest[corner[1]] * place[1]
        + skin.rest[corner[2]] * last
    )


@wp.func
def ghost_share(skin: HandSkin, x: wp.vec3, ghost: int) -> float:
    """A ghost's share of a contact at x [m], not normalized."""
    return wp.max(1.0 - wp.length(skin.ghost_rest[ghost] - x) / skin.ghost_reach, 0.0)


@wp.func
def total_share(skin: HandSkin, face: int, x: wp.vec3) -> float:
    """Sum of the shares of the ghosts around a face: 0 if none is within reach."""
    total = float(0.0)
    for at in range(skin.ghost_begin[face], skin.ghost_begin[face + 1]):
        total += ghost_share(skin, x, skin.ghost[at])
    return total


@wp.func
def contact_share(skin: HandSkin, face: int, at: int, x: wp.vec3, total: float) -> float:
    """A ghost's normalized share of a contact; if no ghost is within reach, the first gets all."""
    if total > 0.0:
        return ghost_share(skin, x, skin.ghost[at]) / total
    return wp.where(at == skin.ghost_begin[face], 1.0, 0.0)


@wp.func
def force_of(
    slots: ContactSlots, resting: wp.array[int], time_step: float, i: int, k: int
) -> wp.vec3:
    """Force of a contact on its particle [N]; slots of sleeping particles hold forces."""
    if resting[i] != 0:
        return slots.impulse[i, k]
    return slots.impulse[i, k] / time_step


@wp.kernel(enable_backward=False)
def gather_forces(
    time_step: float,
    reported: float,
    resting: wp.array[int],
    slots: ContactSlots,
    skin: HandSkin,
    forces: HandForces,
) -> None:
    """Add the forces of a substep to ghosts and nodes."""
    i = wp.tid()
    for k in range(slots.count[i]):
        if slots.collider[i, k] == skin.collider:
            force = -force_of(slots, resting, time_step, i, k)
            wp.atomic_max(forces.deepest, 0, -slots.gap[i, k])
            if wp.length_sq(force) > 0.0:
                wp.atomic_add(forces.touched, 0, 1)
                face = slots.face[i, k]
                x = point_on_skin(skin, face, slots.place[i, k])
                total = total_share(skin, face, x)
                for at in range(skin.ghost_begin[face], skin.ghost_begin[face + 1]):
                    share = contact_share(skin, face, at, x, total)
                    if share > 0.0:
                        ghost = skin.ghost[at]
                        part = force * share
                        push = wp.vec3d(part * (time_step * reported))
                        wp.atomic_add(forces.impulse, ghost, push)
                        corner = skin.ghost_tetrahedron[ghost]
                        weight = skin.ghost_weight[ghost]
                        for c in range(4):
                            wp.atomic_add(forces.load, corner[c], part * weight[c])


def make_skin(rig: HandRig, collider: int, spacing: float, device: wp.Device) -> HandSkin:
    """Create the skin of a rig.

    Args:
        rig: The hand.
        collider: Index of the hand among all colliders.
        spacing: Particle spacing of the clay [m].
        device: Warp device.
    """
    surface = np.flatnonzero(rig.ghost_areas > 0.0)
    reach = max(GHOST_REACH * spacing, 1.01 * rig.ghost_spacing)
    begin, ghosts = _ghosts_by_face(rig, surface, reach)
    skin = HandSkin()
    skin.collider = collider

    def put(values: NDArray, dtype: object) -> wp.array:
        return wp.array(values, dtype=dtype, device=device)

    skin.face = put(rig.faces, wp.vec3i)
    skin.rest = put(rig.vertices, wp.vec3)
    skin.tetrahedron = put(rig.tetrahedra[rig.vertex_tetrahedron], wp.vec4i)
    skin.weight = put(rig.vertex_weights, wp.vec4)
    skin.group = put(_bone_of_faces(rig), int)
    skin.ghost_begin, skin.ghost = put(begin, int), put(ghosts, int)
    skin.ghost_rest = put(rig.carried_ghosts(rig.nodes)[surface], wp.vec3)
    skin.ghost_reach = reach
    skin.ghost_tetrahedron = put(rig.tetrahedra[rig.ghost_tetrahedron[surface]], wp.vec4i)
    skin.ghost_weight = put(rig.ghost_weights[surface], wp.vec4)
    return skin


def _bone_of_faces(rig: HandRig) -> NDArray[np.int32]:
    """The bone with the largest weight for each face, shape [F]."""
    shares = np.zeros((len(rig.nodes), len(rig.bone_names)))
    np.add.at(shares, (np.arange(len(rig.nodes))[:, None], rig.node_bones), rig.node_weights)
    corners = rig.tetrahedra[rig.vertex_tetrahedron]
    of_vertices = np.einsum("vk,vkb->vb", rig.vertex_weights, shares[corners])
    return of_vertices[rig.faces].sum(1).argmax(1).astype(np.int32)


def _ghosts_by_face(
    rig: HandRig, surface: NDArray[np.int64], reach: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Surface ghosts around each face, on its own side of the hand.

    Returns:
        Index of the first ghost of each face, shape [F + 1], and the ghosts as indices into
        ``surface``.
    """
    positions, normals = rig.carried_ghosts(rig.nodes)[surface], rig.ghost_normals[surface]
    corners = rig.vertices[rig.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low, high = corners.min(1) - reach, corners.max(1) + reach
    # Sorting along the hand leaves only a few candidates for each face.
    along = int(np.ptp(positions, axis=0).argmax())
    order = np.argsort(positions[:, along], kind="stable")
    ordered = positions[order, along]
    begins = np.searchsorted(ordered, low[:, along], side="right")
    counts = np.maximum(np.searchsorted(ordered, high[:, along], side="left") - begins, 0)
    found = []
    for first in range(0, len(corners), _CHUNK_SIZE):
        count = counts[first : first + _CHUNK_SIZE]
        face = np.repeat(np.arange(first, first + len(count)), count)
        rank = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
        ghost = order[begins[face] + rank]
        for axis in {0, 1, 2} - {along}:
            coordinate = positions[ghost, axis]
            kept = (coordinate > low[face, axis]) & (coordinate < high[face, axis])
            face, ghost = face[kept], ghost[kept]
        kept = (normals[ghost] * outward[face]).sum(1) > 0.0
        face, ghost = face[kept], ghost[kept]
        kept = _distance_to_triangles(positions[ghost], corners[face]) < reach
        found.append(np.column_stack([face[kept], ghost[kept]]))
    pairs = np.concatenate(found)
    # Faces without a ghost within reach get the nearest one.
    for face in np.setdiff1d(np.arange(len(corners)), pairs[:, 0]):
        repeated = np.broadcast_to(corners[face], (len(positions), 3, 3))
        nearest = _distance_to_triangles(positions, repeated).argmin()
        pairs = np.concatenate([pairs, [[face, nearest]]])
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    begin = np.searchsorted(pairs[:, 0], np.arange(len(corners) + 1))
    return begin.astype(np.int32), pairs[:, 1].astype(np.int32)


def _distance_to_triangles(
    points: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance of each point, shape [P, 3], from its own triangle, shape [P, 3, 3] [m]."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    nearest = np.full(len(points), np.inf)
    inside = size > 0.0
    for k in range(3):
        start, axis = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        offset = points - start
        along = (offset * axis).sum(1) / np.maximum((axis * axis).sum(1), 1e-30)
        rest = offset - np.clip(along, 0.0, 1.0)[:, None] * axis
        nearest = np.minimum(nearest, np.linalg.norm(rest, axis=1))
        inside &= (np.cross(axis, offset) * normal).sum(1) >= 0.0
    height = np.abs(((points - corners[:, 0]) * normal).sum(1)) / np.maximum(size, 1e-30)
    return np.where(inside, height, nearest)
