# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes over pairs for the CPU's vector units: eight pairs of a row at a time.

They take most of a frame. The kernels of `pair_rows` with the same names are the same passes for
reading and for graphics cards; tests hold the two to the same results. Lanes behind the last
pair of a row have no stiffness and no slope, so that they add nothing.
"""

import warp as wp

from .awake import Awake
from .bond_law import FORGETTING, SOFTEST, Body, Clay, PairLaw
from .pair_rows import PairRows, lay_row, measure_row, sort_row
from .vector_units import BLOCK, OPTIONS, for_one, over_block

wp.set_module_options(OPTIONS)

_ROW = """
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

# How a particle's volume and stress are summed up while its pairs are measured, and
# `bond_law.flow_share`.
_MEASURE_SETUP = """
    const float* __restrict__ v = (const float*)velocity.data;
    const float dt = clay.time_step, inverse_radius = 1.f / clay.kernel_radius;
    const float area = clay.spacing * clay.spacing;
    // `bond_law.flow_rate`
    auto flow_rate = [](float stiff, float consistency, float index, float excess) {
        float rate = excess / (stiff + consistency);
        if (index != 1.f && consistency > 0.f) {
            const float slow = __builtin_powf(excess / consistency, 1.f / index);
            rate = excess / stiff < slow ? excess / stiff : slow;
            if (index < 1.f) rate *= __builtin_powf(2.f, -1.f / index);
            for (int k = 0; k < 4; k++) {
                const float drag = consistency * __builtin_powf(rate, index);
                rate += (excess - stiff * rate - drag) / (stiff + index * drag / rate);
            }
        }
        return rate;
    };
"""
_MEASURE = """
    const float vx = v[3 * i], vy = v[3 * i + 1], vz = v[3 * i + 2];
    f8 density = zero, lengths = zero;
    f8 xx = zero, xy = zero, xz = zero, yy = zero, yz = zero, zz = zero;
    auto measure = [&](int e, i8 live, f8 x, f8 y, f8 z, f8 before) __attribute__((always_inline)) {
        f8 wx, wy, wz;
        pick3(v, other + e, wx, wy, wz);
        wx = x * before + (wx - vx) * dt;
        wy = y * before + (wy - vy) * dt;
        wz = z * before + (wz - vz) * dt;
        const f8 apart = root(wx * wx + wy * wy + wz * wz);
        const f8 rest = load(rests + e);
        const i8 bonded = live & (rest > 0.f);
        f8 t = most(1.f - apart * inverse_radius, zero);
        t = live ? t : zero;
        density += t * t * t;
        lengths += bonded ? rest * rest : zero;
        const f8 w = bonded ? (apart - rest) * apart : zero;
        xx += x * x * w;
        xy += x * y * w;
        xz += x * z * w;
        yy += y * y * w;
        yz += y * z * w;
        zz += z * z * w;
        store(next + e, apart);
    };
    auto keep_measures = [&]() __attribute__((always_inline)) {
        const float dense = (1.f + sum(density)) * clay.inverse_rest_sum - 1.f;
        const float square = sum(lengths);
        const float sxx = sum(xx), syy = sum(yy), szz = sum(zz);
        const float sxy = sum(xy), sxz = sum(xz), syz = sum(yz), trace = sxx + syy + szz;
        const float least_square = 1e-12f * area;
        pairs.compression.data[i] = dense > 0.f ? dense : 0.f;
        pairs.dilation.data[i] = trace / (square > least_square ? square : least_square);
        const auto& body = bodies.data[material.data[i]];
        const float mean = trace * (1.f / 3.f);
        const float dx = sxx - mean, dy = syy - mean, dz = szz - mean;
        const float norm = 0.5f * (dx * dx + dy * dy + dz * dz) + sxy * sxy + sxz * sxz + syz * syz;
        const float stress = 0.5f * body.shear_modulus / area * __builtin_sqrtf(norm);
        const float excess = stress - body.yield_stress;
        float share = 0.f;
        if (excess > 0.f) {
            const float stiff = body.shear_modulus * square / (30.f * area) * dt;
            share = stiff * flow_rate(stiff, body.consistency, body.flow_index, excess) / stress;
        }
        pairs.share.data[i] = share;
    };
"""

# `bond_law.flow_bond`, eight bonds at a time.
_LAW_SETUP = """
    const bool uniform = clay.material_count == 1;
    const float* __restrict__ dilations = pairs.dilation.data;
    const float* __restrict__ shares = pairs.share.data;
    const float* __restrict__ compressions = pairs.compression.data;
    f8 law_stiffness = (f8)(pair_laws.data[0].stiffness);
    f8 law_tension = (f8)(pair_laws.data[0].tension_stretch);
    f8 law_draw = (f8)(pair_laws.data[0].draw);
    auto take_laws = [&](int i, const int* other) __attribute__((always_inline)) {
        const auto* laws = pair_laws.data + (long long)material.data[i] * clay.material_count;
        for (int l = 0; l < 8; l++) {
            const auto& law = laws[material.data[other[l]]];
            law_stiffness[l] = law.stiffness;
            law_tension[l] = law.tension_stretch;
            law_draw[l] = law.draw;
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
        flow += draws ? over * law_draw : zero;
        softening = 1.f - share;
        const f8 drawn = 1.f - law_draw * over / (draws ? stretch : (f8)(1.f));
        softening = draws ? least(softening, drawn) : softening;
        softening = most(softening, (f8)(softest));
        return most(rest + flow, (f8)(clay.shortest_length));
    };
""".replace("forgetting", f"{FORGETTING}f").replace("softest", f"{SOFTEST}f")


_LAY_SETUP = (
    _MEASURE_SETUP
    + """
    const float* __restrict__ x = (const float*)position.data;
    const float floor = 1e-6f * clay.spacing, reach = clay.form_reach * clay.form_reach;
    const i8 forms = (i8)(clay.bonds ? -1 : 0);
"""
)
_LAY = (
    _ROW
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
        _ROW
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
        _LAW_SETUP
        + """
    const float dt = clay.time_step, square = dt * dt;
    const float inverse_radius = 1.f / clay.kernel_radius;
    const float slope_scale = 3.f * clay.inverse_rest_sum * inverse_radius;
""",
        _ROW
        + """
    const auto& body = bodies.data[material.data[i]];
    const float own_compression = compressions[i];
    const float own_dilation = 0.5f * dilations[i], own_share = 0.5f * shares[i];
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
        const f8 compression = pick(compressions, other + e);
        const f8 dilation = own_dilation + 0.5f * pick(dilations, other + e);
        const f8 share = own_share + 0.5f * pick(shares, other + e);
        const i8 bonded = live & (rest > 0.f);
        f8 softening;
        const i8 pressed = own_compression + compression > 0.f;
        const f8 flowed = flow_bond(rest, apart, dilation, share, pressed, softening);
        f8 pull = -(own_pressure + other_stiffness * compression) * a;
        pull += bonded ? law_stiffness * (apart - flowed) : zero;
        const f8 k = bonded ? law_stiffness * softening * square : zero;
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
        _ROW
        + """
    const float vx = v[3 * i], vy = v[3 * i + 1], vz = v[3 * i + 2];
    for (int e = 0; e < end; e += 8) {
        if (!uniform) take_laws(i, other + e);
        const f8 rest = load(rests + e), before = load(distance + e);
        const f8 compression = pick(compressions, other + e);
        const f8 dilation = 0.5f * (dilations[i] + pick(dilations, other + e));
        const f8 share = 0.5f * (shares[i] + pick(shares, other + e));
        f8 x, y, z, softening;
        pick3(v, other + e, x, y, z);
        x = load(nx + e) * before + (x - vx) * dt;
        y = load(ny + e) * before + (y - vy) * dt;
        z = load(nz + e) * before + (z - vz) * dt;
        const f8 apart = root(x * x + y * y + z * z);
        const i8 pressed = compressions[i] + compression > 0.f;
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


_DIRECTION = """
    const float px = p[3 * i], py = p[3 * i + 1], pz = p[3 * i + 2];
"""


@wp.func_native(
    over_block(
        """
    const float* __restrict__ p = (const float*)direction.data;
    const float square = time_step * time_step;
""",
        """
    if (pairs.compression.data[i] <= 0.f) {
        pressure_change.data[i] = 0.f;
        continue;
    }
"""
        + _ROW
        + _DIRECTION
        + """
    f8 total = zero;
    for (int e = 0; e < end; e += 8) {
        f8 x, y, z;
        pick3(p, other + e, x, y, z);
        total += load(slope + e)
            * (load(nx + e) * (px - x) + load(ny + e) * (py - y) + load(nz + e) * (pz - z));
    }
    const float scale = bodies.data[material.data[i]].pressure_stiffness * square;
    pressure_change.data[i] = sum(total) * scale;
""",
    )
)
def press_block(
    block: int,
    awake: Awake,
    bodies: wp.array[Body],
    material: wp.array[int],
    time_step: float,
    pairs: PairRows,
    direction: wp.array[wp.vec3],
    pressure_change: wp.array[float],
) -> None: ...


@wp.kernel(enable_backward=False)
def press_pairs(
    awake: Awake,
    bodies: wp.array[Body],
    material: wp.array[int],
    time_step: float,
    pairs: PairRows,
    direction: wp.array[wp.vec3],
    pressure_change: wp.array[float],
) -> None:
    """`pair_rows.press_pairs`."""
    press_block(wp.tid(), awake, bodies, material, time_step, pairs, direction, pressure_change)


@wp.func_native(
    over_block(
        """
    const float* __restrict__ p = (const float*)direction.data;
    const float* __restrict__ pressure = pressure_change.data;
    double energy = 0.0;
""",
        _ROW
        + _DIRECTION
        + """
    const float own = pressure[i];
    f8 ax = zero, ay = zero, az = zero;
    for (int e = 0; e < end; e += 8) {
        f8 x, y, z;
        pick3(p, other + e, x, y, z);
        const f8 dx = load(nx + e), dy = load(ny + e), dz = load(nz + e);
        const f8 closing = dx * (px - x) + dy * (py - y) + dz * (pz - z);
        const f8 pull = load(stiffness + e) * closing
            + load(slope + e) * (own + pick(pressure, other + e));
        ax += dx * pull;
        ay += dy * pull;
        az += dz * pull;
    }
    const float* b = (const float*)own_block.data + 9 * (long long)i;
    const float x = sum(ax) + b[0] * px + b[1] * py + b[2] * pz;
    const float y = sum(ay) + b[3] * px + b[4] * py + b[5] * pz;
    const float z = sum(az) + b[6] * px + b[7] * py + b[8] * pz;
    float* total = (float*)product.data + 3 * (long long)i;
    total[0] = x;
    total[1] = y;
    total[2] = z;
    energy += x * px + y * py + z * pz;
""",
        "curvature.data[awake.part * curvature.shape[1] + iteration] += energy;",
    )
)
def multiply_block(
    block: int,
    awake: Awake,
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    pressure_change: wp.array[float],
    direction: wp.array[wp.vec3],
    product: wp.array[wp.vec3],
    curvature: wp.array2d[wp.float64],
    iteration: int,
) -> None: ...


@wp.kernel(enable_backward=False)
def multiply_pairs(
    awake: Awake,
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    pressure_change: wp.array[float],
    direction: wp.array[wp.vec3],
    product: wp.array[wp.vec3],
    curvature: wp.array2d[wp.float64],
    iteration: int,
) -> None:
    """`pair_rows.multiply_pairs`."""
    multiply_block(
        wp.tid(),
        awake,
        pairs,
        own_block,
        pressure_change,
        direction,
        product,
        curvature,
        iteration,
    )
