# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes over pairs for the CPU's vector units: eight pairs of a row at a time.

They take most of a frame. The kernels of `pair_rows` with the same names are the same passes for
reading and for graphics cards; tests hold the two to the same results. Lanes behind the last
pair of a row have no stiffness and no slope, so that they add nothing.
"""

import warp as wp

from ...core.awake import Awake
from ...core.vector_units import BLOCK, OPTIONS, for_one, over_block
from ..law import (
    DAMPING_OF_VISCOSITY,
    FORGETTING,
    LEAST_SQUARES,
    SLOWEST_RATE,
    SOFTEST,
    Body,
    Clay,
    PairLaw,
)
from .rows import PairRows, lay_row, measure_row, sort_row

wp.set_module_options(OPTIONS)

_HOLD = """
    // `bond_law.bond_hold`
    auto bond_hold = [&](f8 rest) __attribute__((always_inline)) {
        return least(most((clay.break_length - rest) * clay.inverse_fade, zero), (f8)(1.f));
    };
"""
ROW = """
    const int acting = pairs.acting.data[i];
    const int end = (acting + 7) & ~7;
    const long long row = pairs.first.data[i];
    const int* __restrict__ other = pairs.other.data + row;
    float* __restrict__ rests = pairs.rest_length.data + row;
    float* __restrict__ nx = pairs.direction_x.data + row;
    float* __restrict__ ny = pairs.direction_y.data + row;
    float* __restrict__ nz = pairs.direction_z.data + row;
    float* __restrict__ distance = pairs.distance.data + row;
    float* __restrict__ next = pairs.distance_next.data + row;
    float* __restrict__ stiffness = pairs.stiffness.data + row;
    float* __restrict__ slope = pairs.slope.data + row;
"""

# How a particle's volume, stress and strain rate are summed up while its pairs are measured, then
# `bond_law.flow_share` and `bond_law.pair_damping`.
_MEASURE_SETUP = (
    _HOLD
    + """
    const float* __restrict__ v = (const float*)velocity.data;
    const float dt = clay.time_step, inverse_radius = 1.f / clay.kernel_radius;
    const float area = clay.spacing * clay.spacing;
    const float least_squares = least_squares_over_area * area;
""".replace("least_squares_over_area", f"{LEAST_SQUARES}f")
)
_MEASURE = """
    const float vx = v[3 * i], vy = v[3 * i + 1], vz = v[3 * i + 2];
    f8 towards_x = zero, towards_y = zero, towards_z = zero;
    f8 density = zero, lengths = zero, squares = zero, parting = zero, rates = zero;
    f8 xx = zero, xy = zero, xz = zero, yy = zero, yz = zero, zz = zero;
    auto measure = [&](int e, i8 live, f8 x, f8 y, f8 z, f8 before) __attribute__((always_inline)) {
        f8 wx, wy, wz;
        pick3(v, other + e, wx, wy, wz);
        wx -= vx;
        wy -= vy;
        wz -= vz;
        const f8 speed = live ? x * wx + y * wy + z * wz : zero;
        wx = x * before + wx * dt;
        wy = y * before + wy * dt;
        wz = z * before + wz * dt;
        const f8 square = wx * wx + wy * wy + wz * wz;
        const f8 apart = root(square);
        const f8 rest = load(rests + e);
        const i8 bonded = live & (rest > 0.f);
        f8 t = most(1.f - apart * inverse_radius, zero);
        t = live ? t : zero;
        const f8 value = t * t * t;
        density += value;
        towards_x += x * value;
        towards_y += y * value;
        towards_z += z * value;
        squares += live ? square : zero;
        parting += apart * speed;
        rates += speed * speed;
        f8 w = bonded ? bond_hold(rest) : zero;
        lengths += w * rest * rest;
        w *= (apart - rest) * apart;
        xx += x * x * w;
        xy += x * y * w;
        xz += x * z * w;
        yy += y * y * w;
        yz += y * z * w;
        zz += z * z * w;
        store(next + e, apart);
    };
    auto keep_measures = [&]() __attribute__((always_inline)) {
        const float tx = sum(towards_x), ty = sum(towards_y), tz = sum(towards_z);
        // `bond_law.surface_density`
        float surface = __builtin_sqrtf(tx * tx + ty * ty + tz * tz) * clay.inverse_rest_sum;
        surface = clay.surface_gain * (surface - clay.surface_floor);
        surface = surface > 0.f ? surface : 0.f;
        const float dense = (1.f + sum(density)) * clay.inverse_rest_sum - 1.f + surface;
        const float bonds = sum(lengths), least_bonds = 1e-12f * area;
        const float sxx = sum(xx), syy = sum(yy), szz = sum(zz);
        const float sxy = sum(xy), sxz = sum(xz), syz = sum(yz), trace = sxx + syy + szz;
        const auto& body = bodies.data[material.data[i]];
        const float mean = trace * (1.f / 3.f);
        const float dx = sxx - mean, dy = syy - mean, dz = szz - mean;
        const float norm = 0.5f * (dx * dx + dy * dy + dz * dz) + sxy * sxy + sxz * sxz + syz * syz;
        const float stress = 0.5f * body.shear_modulus / area * __builtin_sqrtf(norm);
        float reach = sum(squares);
        reach = reach > least_squares ? reach : least_squares;
        float viscosity = body.consistency;
        if (body.flow_index != 1.f) {
            const float growth = sum(parting) / reach;
            const float rate = 15.f * (sum(rates) / reach - growth * growth);
            const float slowest = slowest_rate * slowest_rate;
            viscosity *= __builtin_powf(rate > slowest ? rate : slowest,
                0.5f * (body.flow_index - 1.f));
        }
        float* condition = (float*)pairs.condition.data + 4 * (long long)i;
        condition[0] = dense > 0.f ? dense : 0.f;
        condition[1] = trace / (bonds > least_bonds ? bonds : least_bonds);
        condition[2] = stress > body.yield_stress ? 1.f - body.yield_stress / stress : 0.f;
        const float damping = damping_scale * area * clay.spacing * viscosity / reach;
        const float most_damping = body.mass * clay.most_damping;
        condition[3] = damping < most_damping ? damping : most_damping;
    };
""".replace("slowest_rate", f"{SLOWEST_RATE}f").replace("damping_scale", f"{DAMPING_OF_VISCOSITY}f")

# `bond_law.flow_bond`, eight bonds at a time.
_LAW_SETUP = """
    const bool uniform = clay.material_count == 1;
    const float* __restrict__ conditions = (const float*)pairs.condition.data;
    f8 law_stiffness = (f8)(pair_laws.data[0].stiffness);
    f8 law_tension = (f8)(pair_laws.data[0].tension_stretch);
    auto take_laws = [&](int i, const int* other) __attribute__((always_inline)) {
        const auto* laws = pair_laws.data + (long long)material.data[i] * clay.material_count;
        for (int l = 0; l < 8; l++) {
            const auto& law = laws[material.data[other[l]]];
            law_stiffness[l] = law.stiffness;
            law_tension[l] = law.tension_stretch;
        }
    };
    auto flow_bond = [&](f8 rest, f8 apart, f8 dilation, f8 share, i8 pressed, f8& softening)
        __attribute__((always_inline)) {
        const f8 stretch = apart - rest;
        const f8 volume_stretch = dilation * rest;
        f8 flow = share * (stretch - volume_stretch);
        const i8 forgets = (volume_stretch < 0.f) | pressed;
        flow += forgets ? volume_stretch * least(share * forgetting, (f8)(1.f)) : zero;
        const f8 over = stretch - flow - law_tension;
        const i8 draws = over > 0.f;
        flow += draws ? over : zero;
        softening = 1.f - share;
        const f8 drawn = 1.f - over / (draws ? stretch : (f8)(1.f));
        softening = draws ? least(softening, drawn) : softening;
        softening = most(softening, (f8)(softest));
        return most(rest + flow, (f8)(clay.shortest_length));
    };
""".replace("forgetting", f"{FORGETTING}f").replace("softest", f"{SOFTEST}f")


_LAY_SETUP = (
    _MEASURE_SETUP
    + """
    const float* __restrict__ x = (const float*)position.data;
    const float floor = 1e-6f * clay.spacing, reach = clay.press_reach * clay.press_reach;
    const i8 forms = (i8)(clay.bonds ? -1 : 0);
"""
)
_LAY = (
    ROW
    + _MEASURE
    + """
    const float px = x[3 * i], py = x[3 * i + 1], pz = x[3 * i + 2];
    const int listed = pairs.listed.data[i];
    i8 found = (i8)(0), coincident = (i8)(0);
    for (int e = acting & ~7; e < listed; e += 8) {
        f8 qx, qy, qz;
        pick3(x, other + e, qx, qy, qz);
        qx -= px;
        qy -= py;
        qz -= pz;
        const i8 near = qx * qx + qy * qy + qz * qz < reach;
        found |= (lanes + e >= acting) & (lanes + e < listed) & near;
    }
    for (int e = 0; e < end; e += 8) {
        f8 qx, qy, qz;
        pick3(x, other + e, qx, qy, qz);
        qx -= px;
        qy -= py;
        qz -= pz;
        const i8 live = lanes + e < acting;
        const f8 apart = root(qx * qx + qy * qy + qz * qz);
        const f8 rest = load(rests + e);
        const i8 leaves = (apart > clay.break_length) | (rest == 0.f);
        const i8 changes = (rest <= 0.f) & (leaves | ((apart < clay.form_reach) & forms));
        found |= live & changes;
        coincident |= live & (apart <= floor);
        const f8 inverse = live ? 1.f / most(apart, (f8)(floor)) : zero;
        qx *= inverse;
        qy *= inverse;
        qz *= inverse;
        store(nx + e, qx);
        store(ny + e, qy);
        store(nz + e, qz);
        store(distance + e, apart);
        measure(e, live, qx, qy, qz, apart);
    }
    keep_measures();
"""
)


@wp.func_native(
    over_block(
        _LAY_SETUP + "int left_count = 0;",
        _LAY
        + """
    const int leave = __builtin_reduce_or(found | coincident) != 0;
    left.data[i] = leave;
    left_count += leave;
""",
        "return left_count;",
    )
)
def lay_block(  # type: ignore[empty-body]
    block: int,
    awake: Awake,
    clay: Clay,
    bodies: wp.array[Body],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    left: wp.array[int],
) -> int: ...


@wp.func_native(
    for_one(_LAY_SETUP, _LAY, "return __builtin_reduce_or(coincident) != 0;"),
)
def lay_one(  # type: ignore[empty-body]
    i: int,
    clay: Clay,
    bodies: wp.array[Body],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> bool: ...


@wp.kernel(enable_backward=False)
def lay_pairs(
    awake: Awake,
    clay: Clay,
    bodies: wp.array[Body],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    left: wp.array[int],
) -> None:
    """`pair_rows.lay_pairs`, which itself takes coincident particles and rows that change."""
    block = wp.tid()
    if lay_block(block, awake, clay, bodies, material, position, velocity, pairs, left) > 0:
        for thread in range(block * BLOCK, wp.min((block + 1) * BLOCK, awake.count[0])):
            i = awake.index[thread]
            if left[i] > 0:
                sort_row(clay, position, pairs, i)
                # Both ends of a pair must be laid by the same arithmetic, to the last bit.
                if lay_one(i, clay, bodies, material, position, velocity, pairs):
                    lay_row(clay, position, pairs, i)
                    measure_row(clay, bodies, material, velocity, pairs, i)


@wp.func_native(
    over_block(
        _MEASURE_SETUP,
        ROW
        + _MEASURE
        + """
    for (int e = 0; e < end; e += 8) {
        const i8 live = lanes + e < acting;
        measure(e, live, load(nx + e), load(ny + e), load(nz + e), load(distance + e));
    }
    keep_measures();
""",
    )
)
def measure_block(
    block: int,
    awake: Awake,
    clay: Clay,
    bodies: wp.array[Body],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None: ...


@wp.kernel(enable_backward=False)
def measure_pairs(
    awake: Awake,
    clay: Clay,
    bodies: wp.array[Body],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """`pair_rows.measure_pairs`."""
    measure_block(wp.tid(), awake, clay, bodies, material, velocity, pairs)


@wp.func_native(
    over_block(
        _HOLD
        + _LAW_SETUP
        + """
    const float dt = clay.time_step, square = dt * dt, per_step = 1.f / dt;
    const float inverse_radius = 1.f / clay.kernel_radius;
    const float slope_scale = 3.f * clay.inverse_rest_sum * inverse_radius;
""",
        ROW
        + """
    const auto& body = bodies.data[material.data[i]];
    const float* condition = conditions + 4 * (long long)i;
    const float own_compression = condition[0], own_dilation = 0.5f * condition[1];
    const float own_share = 0.5f * condition[2], own_damping = 0.5f * condition[3];
    const float own_pressure = body.pressure_stiffness * own_compression;
    f8 other_stiffness = (f8)(body.pressure_stiffness);
    f8 fx = zero, fy = zero, fz = zero, sx = zero, sy = zero, sz = zero;
    f8 xx = zero, xy = zero, xz = zero, yy = zero, yz = zero, zz = zero;
    for (int e = 0; e < end; e += 8) {
        if (!uniform) {
            take_laws(i, other + e);
            for (int l = 0; l < 8; l++)
                other_stiffness[l] = bodies.data[material.data[other[e + l]]].pressure_stiffness;
        }
        const i8 live = lanes + e < acting;
        const f8 apart = load(next + e), rest = load(rests + e);
        const f8 x = load(nx + e), y = load(ny + e), z = load(nz + e);
        const f8 t = most(1.f - apart * inverse_radius, zero);
        const f8 a = live ? t * t * slope_scale : zero;
        f8 compression, dilation, share, damping;
        pick4(conditions, other + e, compression, dilation, share, damping);
        dilation = own_dilation + 0.5f * dilation;
        share = own_share + 0.5f * share;
        damping = live ? own_damping + 0.5f * damping : zero;
        const i8 bonded = live & (rest > 0.f);
        f8 softening;
        const i8 pressed = own_compression + compression > 0.f;
        const f8 flowed = flow_bond(rest, apart, dilation, share, pressed, softening);
        f8 pull = damping * (apart - load(distance + e)) * per_step;
        pull -= (own_pressure + other_stiffness * compression) * a;
        const f8 hold = bonded ? law_stiffness * bond_hold(rest) : zero;
        pull += hold * (apart - flowed);
        const f8 k = damping * dt + hold * softening * square;
        store(stiffness + e, k);
        store(slope + e, a);
        const f8 w = k + (compression > 0.f ? other_stiffness * square * a * a : zero);
        fx += x * pull;
        fy += y * pull;
        fz += z * pull;
        sx += x * a;
        sy += y * a;
        sz += z * a;
        xx += x * x * w;
        xy += x * y * w;
        xz += x * z * w;
        yy += y * y * w;
        yz += y * z * w;
        zz += z * z * w;
    }
    const float px = sum(sx), py = sum(sy), pz = sum(sz);
    const float s = own_compression > 0.f ? body.pressure_stiffness * square : 0.f;
    const float bxy = sum(xy) + s * px * py, bxz = sum(xz) + s * px * pz;
    const float byz = sum(yz) + s * py * pz;
    float* entry = (float*)diagonal.data + 9 * (long long)i;
    entry[0] = body.mass + sum(xx) + s * px * px;
    entry[1] = entry[3] = bxy;
    entry[2] = entry[6] = bxz;
    entry[4] = body.mass + sum(yy) + s * py * py;
    entry[5] = entry[7] = byz;
    entry[8] = body.mass + sum(zz) + s * pz * pz;
    const float* free = (const float*)velocity_free.data + 3 * (long long)i;
    const float* now = (const float*)velocity.data + 3 * (long long)i;
    float* missing = (float*)residual.data + 3 * (long long)i;
    missing[0] = (free[0] - now[0]) * body.mass + sum(fx) * dt;
    missing[1] = (free[1] - now[1]) * body.mass + sum(fy) * dt;
    missing[2] = (free[2] - now[2]) * body.mass + sum(fz) * dt;
""",
    )
)
def sum_forces_block(
    block: int,
    awake: Awake,
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    bodies: wp.array[Body],
    material: wp.array[int],
    velocity_free: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
) -> None: ...


@wp.kernel(enable_backward=False)
def sum_forces(
    awake: Awake,
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    bodies: wp.array[Body],
    material: wp.array[int],
    velocity_free: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
) -> None:
    """`pair_rows.sum_forces`."""
    sum_forces_block(
        wp.tid(),
        awake,
        clay,
        pair_laws,
        bodies,
        material,
        velocity_free,
        velocity,
        pairs,
        residual,
        diagonal,
    )


@wp.func_native(
    over_block(
        _LAW_SETUP
        + """
    const float* __restrict__ v = (const float*)velocity.data;
    const float dt = clay.time_step;
""",
        ROW
        + """
    const float* condition = conditions + 4 * (long long)i;
    const float vx = v[3 * i], vy = v[3 * i + 1], vz = v[3 * i + 2];
    for (int e = 0; e < end; e += 8) {
        if (!uniform) take_laws(i, other + e);
        const f8 rest = load(rests + e), before = load(distance + e);
        f8 compression, dilation, share, damping, x, y, z, softening;
        pick4(conditions, other + e, compression, dilation, share, damping);
        dilation = 0.5f * (condition[1] + dilation);
        share = 0.5f * (condition[2] + share);
        pick3(v, other + e, x, y, z);
        x = load(nx + e) * before + (x - vx) * dt;
        y = load(ny + e) * before + (y - vy) * dt;
        z = load(nz + e) * before + (z - vz) * dt;
        const f8 apart = root(x * x + y * y + z * z);
        const i8 pressed = condition[0] + compression > 0.f;
        f8 flowed = flow_bond(rest, apart, dilation, share, pressed, softening);
        flowed = most(apart, flowed) > clay.break_length ? zero : flowed;
        const i8 bonded = (lanes + e < acting) & (rest > 0.f);
        store(rests + e, bonded ? flowed : rest);
    }
""",
    )
)
def flow_block(
    block: int,
    awake: Awake,
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None: ...


@wp.kernel(enable_backward=False)
def flow_pairs(
    awake: Awake,
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """`pair_rows.flow_pairs`."""
    flow_block(wp.tid(), awake, clay, pair_laws, material, velocity, pairs)
