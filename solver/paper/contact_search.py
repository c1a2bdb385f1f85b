# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for the ghost particles that a clay particle meets in a substep of the paper's model.

Section III-D of the paper sets a constraint for every ghost within a radius. Here a particle meets
the nearest ghost of a mesh, and others only if it is outside them and their normals differ, as in a
corner: many ghosts of one face would be redundant, and those of the other face of a rim would push
away particles that lie on this one.
"""

import warp as wp

from ..contact.law import ContactPass

MAX_CONSTRAINTS = 4
"""Largest number of constraints of a particle."""
MAX_MESH_CONSTRAINTS = 3
"""Largest number of constraints with one mesh: a corner has three faces."""
DIFFERENT_NORMALS = 0.7
"""Cosine of two normals below which ghosts belong to different faces."""
BESIDE = 0.75
"""Lateral distance from the nearest ghost at which a particle is off a rim, in particle radii."""
ANCHOR_MEMORY = 2
"""An anchor is dropped after this many substeps without contact."""


@wp.struct
class GhostConstraints:
    """Constraints of all particles, `MAX_CONSTRAINTS` for each."""

    count: wp.array[int]
    collider: wp.array2d[int]
    ghost: wp.array2d[int]
    """Index among the ghosts of its mesh; -1 on a plane."""
    normal: wp.array2d[wp.vec3]
    gap: wp.array2d[float]
    """Gap between the ball's current position and the surface at the substep's end [m]."""
    surface_motion: wp.array2d[wp.vec3]
    """Motion of the surface in this substep [m]."""
    stretch: wp.array2d[wp.vec3]
    """Offset from the anchor to the particle at the start of the substep [m]."""
    idle: wp.array2d[int]
    """Substeps since the particle was last pushed."""
    push: wp.array2d[float]
    """Sum of the projections by impenetrability in this substep [m]."""
    drag: wp.array2d[wp.vec3]
    """Sum of the projections by friction in this substep [m]."""
    count_before: wp.array[int]
    collider_before: wp.array2d[int]
    normal_before: wp.array2d[wp.vec3]
    stretch_before: wp.array2d[wp.vec3]
    idle_before: wp.array2d[int]


@wp.func
def add_constraint(
    slots: GhostConstraints,
    i: int,
    collider: int,
    ghost: int,
    normal: wp.vec3,
    gap: float,
    surface_motion: wp.vec3,
) -> None:
    """Add a constraint to a particle, with the anchor it had on that side of the collider."""
    used = slots.count[i]
    if used < MAX_CONSTRAINTS:
        slots.collider[i, used] = collider
        slots.ghost[i, used] = ghost
        slots.normal[i, used] = normal
        slots.gap[i, used] = gap
        slots.surface_motion[i, used] = surface_motion
        slots.push[i, used] = 0.0
        slots.drag[i, used] = wp.vec3()
        stretch = wp.vec3()
        idle = int(ANCHOR_MEMORY)
        max_cosine = float(DIFFERENT_NORMALS)
        for k in range(slots.count_before[i]):
            if slots.collider_before[i, k] == collider:
                cosine = wp.dot(slots.normal_before[i, k], normal)
                if cosine > max_cosine:
                    max_cosine = cosine
                    stretch = slots.stretch_before[i, k]
                    idle = slots.idle_before[i, k]
        slots.stretch[i, used] = stretch - normal * wp.dot(stretch, normal)
        slots.idle[i, used] = idle
        slots.count[i] = used + 1


@wp.kernel(enable_backward=False)
def find_ghost_contacts(
    common: ContactPass,
    substep: wp.array[int],
    collider: int,
    row: int,
    pose: wp.array2d[wp.transform],
    reach: float,
    grid: wp.uint64,
    ghost_position: wp.array[wp.vec3],
    ghost_normal: wp.array[wp.vec3],
    ghost_drift: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
    slots: GhostConstraints,
) -> None:
    """Find the ghosts of one mesh that a particle may meet in this substep, the nearest first."""
    i = wp.tid()
    before = pose[row, substep[0]]
    after = pose[row, substep[0] + 1]
    local = wp.transform_point(wp.transform_inverse(after), position[i] + displacement[i])
    first = slots.count[i]
    searching = bool(True)
    while searching:
        chosen = int(-1)
        nearest = reach * reach
        for g in wp.hash_grid_query(grid, local, reach):
            offset = local - ghost_position[g]
            above = wp.dot(offset, ghost_normal[g])
            beside = wp.length(offset - ghost_normal[g] * above)
            off_rim = beside > BESIDE * common.radius
            # Distance from the surface that the ghost represents. The lateral part has half weight:
            # with less, a round tool's farthest tangent plane would win, with more a rim's other
            # face.
            distance = above * above + 0.5 * beside * beside
            if off_rim:
                distance = wp.length_sq(offset)
            if distance < nearest or (distance == nearest and g < chosen):
                allowed = bool(True)
                if slots.count[i] > first:
                    normal = wp.transform_vector(after, ghost_normal[g])
                    if above < 0.5 * common.radius or off_rim:
                        allowed = False
                    for k in range(first, slots.count[i]):
                        if wp.dot(normal, slots.normal[i, k]) > DIFFERENT_NORMALS:
                            allowed = False
                if allowed:
                    nearest = distance
                    chosen = g
        searching = False
        if chosen >= 0:
            offset = local - ghost_position[chosen]
            normal = ghost_normal[chosen]
            beside = wp.length(offset - normal * wp.dot(offset, normal))
            if beside > BESIDE * common.radius:
                normal = wp.normalize(offset)
            normal = wp.transform_vector(after, normal)
            place = wp.transform_point(after, ghost_position[chosen])
            start = wp.transform_point(before, ghost_position[chosen] - ghost_drift[chosen])
            gap = wp.dot(position[i] - place, normal) - common.radius
            near = gap + wp.min(wp.dot(displacement[i], normal), 0.0) < common.margin
            if near:
                add_constraint(slots, i, collider, chosen, normal, gap, place - start)
                searching = (
                    slots.count[i] < MAX_CONSTRAINTS
                    and slots.count[i] - first < MAX_MESH_CONSTRAINTS
                )


@wp.kernel(enable_backward=False)
def find_plane_constraints(
    common: ContactPass,
    plane_point: wp.array[wp.vec3],
    plane_normal: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
    slots: GhostConstraints,
) -> None:
    """Find the planes that a particle may meet in this substep."""
    i = wp.tid()
    for plane in range(plane_point.shape[0]):
        normal = plane_normal[plane]
        gap = wp.dot(position[i] - plane_point[plane], normal) - common.radius
        if gap + wp.min(wp.dot(displacement[i], normal), 0.0) < common.margin:
            add_constraint(slots, i, plane, -1, normal, gap, wp.vec3())
