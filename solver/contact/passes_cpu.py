# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact passes for the CPU, which skip the many particles that touch nothing.

Each block of particles is screened for those near a collider; the contact law is that of `law`.
A test compares the screening with `search.comes_near`.
"""

import warp as wp

from ..core.awake import Awake
from ..core.vector_units import BLOCK, OPTIONS, over_block
from .law import ContactPass, ContactSlots, press_contacts, settle_contacts
from .search import Surroundings, find_contacts

wp.set_module_options(OPTIONS)


@wp.struct
class Near:
    """Particles that may touch something in this substep."""

    count: wp.array[int]
    """Number of them in each block."""
    index: wp.array[int]
    """Their indices; those of block b begin at b times the block length."""


def make_near(particle_count: int, device: wp.Device) -> Near:
    """Allocate lists with room for all particles."""
    blocks = (particle_count + BLOCK - 1) // BLOCK
    near = Near()
    near.count = wp.zeros(blocks, dtype=int, device=device)
    near.index = wp.zeros(blocks * BLOCK, dtype=int, device=device)
    return near


@wp.func_native(
    over_block(
        """
    const int planes = around.plane_point.shape[0], meshes = around.mesh.shape[0];
    const long long pitch = meshes ? around.clearance.strides[0] / sizeof(float) : 0;
    const float dt = common.time_step, dt_before = common.time_step_before;
    const float reach = common.radius + common.margin;
    const int substep = meshes ? around.substep.data[0] : 0;
    // A point in the frame of a pose, which is a position followed by a quaternion.
    auto seen_from = [&](const float* pose, f4 x) __attribute__((always_inline)) {
        const f4 offset = x - load3(pose), axis = -load3(pose + 3);
        const f4 turned = cross(axis, offset) * 2.f;
        return offset + turned * pose[6] + cross(axis, turned);
    };
    auto motion_past = [&](int mesh, int number, f4 start, f4 end)
        __attribute__((always_inline)) {
        f4 motion = end - start;
        if (around.turning.data[mesh]) {
            const float* poses = (const float*)((const char*)around.pose.data
                + mesh * (long long)around.pose.strides[0]);
            const float* before = number < 0 ? (const float*)(around.pose_before.data + mesh)
                : poses + 7 * number;
            motion = seen_from(poses + 7 * (number + 1), end) - seen_from(before, start);
        }
        motion *= motion;
        return __builtin_sqrtf(motion.x + motion.y + motion.z) + around.travel.data[mesh];
    };
    int found = 0;
""",
        """
    bool comes = slots.count.data[i] > 0;
    const float* x = (const float*)position.data + 3 * (long long)i;
    const float* v = (const float*)velocity.data + 3 * (long long)i;
    for (int plane = 0; plane < planes; plane++) {
        const float* n = (const float*)around.plane_normal.data + 3 * plane;
        const float* p = (const float*)around.plane_point.data + 3 * plane;
        const float gap = (x[0] - p[0]) * n[0] + (x[1] - p[1]) * n[1] + (x[2] - p[2]) * n[2];
        const float closing = -(v[0] * n[0] + v[1] * n[1] + v[2] * n[2]) * dt;
        comes |= gap - (closing > 0.f ? closing : 0.f) < reach;
    }
    const f4 place = load3(x), velocity_now = load3(v);
    for (int mesh = 0; mesh < meshes; mesh++) {
        float* clearance = around.clearance.data + mesh * pitch + i;
        *clearance -= motion_past(mesh, substep - 1, place - velocity_now * dt_before, place);
        const float coming = motion_past(mesh, substep, place, place + velocity_now * dt);
        comes |= *clearance - coming <= reach;
    }
    if (comes) near.index.data[begin + found++] = i;
""",
        """
    near.count.data[block] = found;
    return found;
""",
    )
)
def screen_block(  # type: ignore[empty-body]
    block: int,
    awake: Awake,
    common: ContactPass,
    around: Surroundings,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
    near: Near,
) -> int: ...


@wp.kernel(enable_backward=False)
def find_all_contacts(
    awake: Awake,
    common: ContactPass,
    around: Surroundings,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    slots: ContactSlots,
    near: Near,
) -> None:
    """`search.find_all_contacts`."""
    block = wp.tid()
    found = screen_block(block, awake, common, around, position, velocity, slots, near)
    for k in range(found):
        find_contacts(common, around, position, velocity, slots, near.index[block * BLOCK + k])


@wp.kernel(enable_backward=False)
def press_all_contacts(
    awake: Awake,
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    mass: wp.array[float],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
    own_block: wp.array[wp.mat33],
    near: Near,
) -> None:
    """`law.press_all_contacts`."""
    block = wp.tid()
    for k in range(near.count[block]):
        i = near.index[block * BLOCK + k]
        press_contacts(
            common,
            friction,
            material,
            mass,
            velocity,
            change,
            slots,
            residual,
            diagonal,
            own_block,
            i,
        )


@wp.kernel(enable_backward=False)
def settle_all_contacts(
    awake: Awake,
    common: ContactPass,
    friction: wp.array2d[float],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    slots: ContactSlots,
    impulse: wp.array[wp.vec3d],
    deepest: wp.array[float],
    near: Near,
) -> None:
    """`law.settle_all_contacts`."""
    block = wp.tid()
    for k in range(near.count[block]):
        i = near.index[block * BLOCK + k]
        settle_contacts(common, friction, material, velocity, change, slots, impulse, deepest, i)
