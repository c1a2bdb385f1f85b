# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for the planes and meshes that a particle may touch in a substep."""

import warp as wp

from ..core.awake import Awake, awake_particle
from .law import MAX_CONTACTS, UNKNOWN_SLIDE, ContactPass, ContactSlots


@wp.func
def add_contact(
    slots: ContactSlots,
    i: int,
    collider: int,
    normal: wp.vec3,
    gap: float,
    surface_motion: wp.vec3,
    turn: wp.quat,
    compliance: wp.vec4,
    face: int,
    place: wp.vec2,
) -> None:
    """Add a contact to a particle, keeping the anchor that it had on this collider."""
    used = slots.count[i]
    if used < MAX_CONTACTS:
        slots.collider[i, used] = collider
        slots.normal[i, used] = normal
        slots.gap[i, used] = gap
        slots.surface_motion[i, used] = surface_motion
        slots.impulse[i, used] = wp.vec3()
        anchor = wp.vec3()
        slide = float(UNKNOWN_SLIDE)
        push = float(0.0)
        borne = wp.vec3()
        held = wp.vec3()
        for k in range(slots.count_before[i]):
            if slots.collider_before[i, k] == collider:
                if compliance[0] > 0.0:
                    borne = slots.borne_before[i, k]
                    held = slots.held_before[i, k]
                anchor = wp.quat_rotate(turn, slots.anchor_before[i, k])
                slide = slots.slide_before[i, k]
                push = slots.push_before[i, k]
        slots.anchor[i, used] = anchor - normal * wp.dot(anchor, normal)
        slots.slide[i, used] = slide
        slots.push[i, used] = push
        slots.normal_stiffness[i, used] = 0.0
        if i < slots.compliance.shape[0]:
            slots.borne[i, used] = borne
            slots.held[i, used] = held
            across = borne * compliance[0] + held * compliance[2]
            along = borne * compliance[1] + held * compliance[3]
            slots.lean[i, used] = along + normal * wp.dot(across - along, normal)
            slots.compliance[i, used] = wp.vec2(
                compliance[0] + compliance[2], compliance[1] + compliance[3]
            )
            slots.face[i, used] = face
            slots.place[i, used] = place
        slots.count[i] = used + 1


@wp.struct
class Surroundings:
    """The colliders, as contact search sees them."""

    plane_point: wp.array[wp.vec3]
    plane_normal: wp.array[wp.vec3]
    mesh: wp.array[wp.uint64]
    pose: wp.array2d[wp.transform]
    """Pose of each mesh at the start of each substep, and at the end of the last."""
    substep: wp.array[int]
    """Index of the current substep; on the device, so that passes can be recorded."""
    reach: wp.array[float]
    """Search distance of each mesh [m]."""
    pose_before: wp.array[wp.transform]
    """Pose of each mesh one substep before the first of `pose`."""
    turning: wp.array[int]
    """1 for a mesh that turns in this step or turned in the last."""
    travel: wp.array[float]
    """Largest motion of each mesh in a substep [m]; for a turning one only its change of shape."""
    clearance: wp.array2d[float]
    """Lower bound of the distance of each particle from each mesh [m], by mesh and particle. Until
    motion can have used it up, the mesh is not queried."""
    first_face: wp.array[int]
    """Index of each mesh's first face in ``compliance``; -1 for a rigid mesh."""
    compliance: wp.array[wp.vec4]
    """Compliance of each face of soft meshes [m/N]: flesh normal to and along it, then joints
    likewise."""


@wp.func
def motion_past(
    around: Surroundings, mesh: int, substep: int, start: wp.vec3, end: wp.vec3
) -> float:
    """Largest motion of a point relative to a mesh in a substep [m].

    For a turning mesh it is measured in the mesh's frame, where clay on a wheel does not move.
    """
    motion = wp.length(end - start)
    if around.turning[mesh] == 1:
        before = around.pose_before[mesh]
        if substep >= 0:
            before = around.pose[mesh, substep]
        after = around.pose[mesh, substep + 1]
        motion = wp.length(
            wp.transform_point(wp.transform_inverse(after), end)
            - wp.transform_point(wp.transform_inverse(before), start)
        )
    return motion + around.travel[mesh]


@wp.func
def comes_near(
    common: ContactPass,
    around: Surroundings,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
    i: int,
) -> bool:
    """Whether a particle may touch something in this substep, or touched it in the last."""
    near = bool(slots.count[i] > 0)
    x = position[i]
    v = velocity[i]
    substep = int(0)
    if around.mesh.shape[0] > 0:
        substep = around.substep[0]
    for plane in range(around.plane_point.shape[0]):
        normal = around.plane_normal[plane]
        gap = wp.dot(x - around.plane_point[plane], normal) - common.radius
        closing = wp.max(-wp.dot(v, normal), 0.0) * common.time_step
        if gap - closing < common.margin:
            near = True
    for mesh in range(around.mesh.shape[0]):
        before = x - v * common.time_step_before
        bound = around.clearance[mesh, i] - motion_past(around, mesh, substep - 1, before, x)
        around.clearance[mesh, i] = bound
        coming = motion_past(around, mesh, substep, x, x + v * common.time_step)
        if bound - coming <= common.radius + common.margin:
            near = True
    return near


@wp.func
def find_contacts(
    common: ContactPass,
    around: Surroundings,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
    i: int,
) -> None:
    """Find the contacts of a particle in this substep; call `comes_near` first."""
    for k in range(slots.count[i]):
        slots.collider_before[i, k] = slots.collider[i, k]
        slots.anchor_before[i, k] = slots.anchor[i, k]
        slots.slide_before[i, k] = slots.slide[i, k]
        slots.push_before[i, k] = slots.push[i, k]
        if i < slots.compliance.shape[0]:
            force = slots.impulse[i, k] / common.time_step_before
            borne = slots.borne[i, k]
            held = slots.held[i, k]
            slots.borne_before[i, k] = borne + (force - borne) * common.yielding[0]
            slots.held_before[i, k] = held + (force - held) * common.yielding[1]
    slots.count_before[i] = slots.count[i]
    slots.count[i] = 0
    x = position[i]
    motion = velocity[i] * common.time_step
    near = common.radius + common.margin
    plane_count = around.plane_point.shape[0]
    for mesh in range(around.mesh.shape[0]):
        coming = motion_past(around, mesh, around.substep[0], x, x + motion)
        bound = around.clearance[mesh, i] - coming
        if bound > near:
            continue
        before = around.pose[mesh, around.substep[0]]
        after = around.pose[mesh, around.substep[0] + 1]
        local = wp.transform_point(wp.transform_inverse(after), x + motion)
        # While motion cannot have used up a positive clearance, the particle is outside: no need
        # to find the sign, which costs several times as much as the nearest point.
        sign = float(1.0)
        reach = around.reach[mesh]
        if bound > 0.0:
            reach = wp.min(reach, 4.0 * near)
            query = wp.mesh_query_point_no_sign(around.mesh[mesh], local, reach)
        elif around.first_face[mesh] >= 0:
            # In a mesh that deforms in every substep, winding numbers would dominate the cost.
            query = wp.mesh_query_point_sign_normal(around.mesh[mesh], local, reach)
            sign = query.sign
        else:
            query = wp.mesh_query_point_sign_winding_number(around.mesh[mesh], local, reach)
            sign = query.sign
        if not query.result:
            around.clearance[mesh, i] = reach - coming
            continue
        nearest = wp.mesh_eval_position(around.mesh[mesh], query.face, query.u, query.v)
        offset = local - nearest
        apart = wp.length(offset)
        around.clearance[mesh, i] = sign * apart - coming
        if sign * apart < near:
            if apart > 1.0e-4 * common.radius:
                normal = offset * (sign / apart)
            else:
                normal = wp.mesh_eval_face_normal(around.mesh[mesh], query.face)
            normal = wp.transform_vector(after, normal)
            drift = wp.mesh_eval_velocity(around.mesh[mesh], query.face, query.u, query.v)
            # Motion of the material at the particle's current position: its next position is only a
            # guess, with which clay on a wheel would creep by half the square of the angle.
            carried = wp.transform_point(wp.transform_inverse(before), x)
            surface_motion = (
                wp.transform_point(after, carried)
                - wp.transform_point(before, carried)
                + wp.transform_vector(after, drift)
            )
            gap = sign * apart - common.radius - wp.dot(motion - surface_motion, normal)
            turn = wp.transform_get_rotation(after) * wp.quat_inverse(
                wp.transform_get_rotation(before)
            )
            compliance = wp.vec4()
            if around.first_face[mesh] >= 0:
                compliance = around.compliance[around.first_face[mesh] + query.face]
            place = wp.vec2(query.u, query.v)
            add_contact(
                slots,
                i,
                plane_count + mesh,
                normal,
                gap,
                surface_motion,
                turn,
                compliance,
                query.face,
                place,
            )
    for plane in range(plane_count):
        normal = around.plane_normal[plane]
        gap = wp.dot(x - around.plane_point[plane], normal) - common.radius
        closing = wp.max(-wp.dot(motion, normal), 0.0)
        if gap - closing < common.margin:
            add_contact(
                slots, i, plane, normal, gap, wp.vec3(), wp.quat_identity(), wp.vec4(), 0, wp.vec2()
            )


@wp.kernel(enable_backward=False)
def find_all_contacts(
    awake: Awake,
    common: ContactPass,
    around: Surroundings,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
) -> None:
    """Find the contacts of each particle in this substep."""
    i = awake_particle(awake, wp.tid())
    if i >= 0 and comes_near(common, around, position, velocity, slots, i):
        find_contacts(common, around, position, velocity, slots, i)
