# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of `measures` for the CPU's vector units: eight pairs of a row at a time.

The kernels of the same names in `measures` are the same passes, for reading and for GPUs; tests
hold the two to the same results. The formulas of both are those of `law`.
"""

import warp as wp

from ...core.awake import Awake
from ...core.vector_units import BLOCK, OPTIONS, for_one, over_block
from ..law import FORMULAS
from ..law_data import ParticleLaw, SharedLaw
from .measures import measure_row, orient_row
from .rows import ROW, PairRows, sort_row

wp.set_module_options(OPTIONS)

# Sums a particle's density, stress and strain rate while its pairs are measured.
_MEASURE_SETUP = (
    FORMULAS
    + """
    const float* __restrict__ v = (const float*)velocity.data;
"""
)
_MEASURE = """
    const float vx = v[3 * i], vy = v[3 * i + 1], vz = v[3 * i + 2];
    f8 towards_x = zero, towards_y = zero, towards_z = zero;
    f8 neighbors = zero, lengths = zero, squares = zero, parting = zero, rates = zero;
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
        const f8 value = live ? kernel_value(apart) : zero;
        neighbors += value;
        towards_x += x * value;
        towards_y += y * value;
        towards_z += z * value;
        squares += live ? square : zero;
        parting += apart * speed;
        rates += speed * speed;
        const f8 hold = bonded ? bond_hold(rest) : zero;
        lengths += hold * rest * rest;
        const f8 w = bond_stretch(hold, rest, apart);
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
        const float lopsided = root(tx * tx + ty * ty + tz * tz);
        const float sxx = sum(xx), syy = sum(yy), szz = sum(zz);
        const auto& own = particle_laws.data[material.data[i]];
        float* condition = (float*)pairs.condition.data + 4 * (long long)i;
        condition[0] = compression_of(sum(neighbors), lopsided);
        condition[1] = dilation_of(sxx + syy + szz, sum(lengths));
        condition[2] = flow_share(own, sxx, syy, szz, sum(xy), sum(xz), sum(yz));
        condition[3] = pair_damping(own, sum(squares), sum(parting), sum(rates));
    };
"""

_GATHER_SETUP = (
    _MEASURE_SETUP
    + """
    const float* __restrict__ x = (const float*)position.data;
"""
)
_GATHER = (
    ROW
    + _MEASURE
    + """
    const float px = x[3 * i], py = x[3 * i + 1], pz = x[3 * i + 2];
    const int listed = pairs.listed.data[i];
    i8 found = (i8)(0), coincide = (i8)(0);
    for (int e = acting & ~7; e < listed; e += 8) {
        f8 qx, qy, qz;
        pick3(x, other + e, qx, qy, qz);
        qx -= px;
        qy -= py;
        qz -= pz;
        const i8 near = begins_to_press(qx * qx + qy * qy + qz * qz);
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
        const i8 leaves = (rest == 0.f) | lets_go(apart);
        const i8 changes = (rest <= 0.f) & (leaves | forms_bond(apart));
        found |= live & changes;
        coincide |= live & (apart <= coincident);
        const f8 inverse = live ? 1.f / maximum(apart, coincident) : zero;
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
        _GATHER_SETUP + "int left_count = 0;",
        _GATHER
        + """
    const int leave = __builtin_reduce_or(found | coincide) != 0;
    left.data[i] = leave;
    left_count += leave;
""",
        "return left_count;",
    )
)
def gather_block(  # type: ignore[empty-body]
    block: int,
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    left: wp.array[int],
) -> int: ...


@wp.func_native(
    for_one(_GATHER_SETUP, _GATHER, "return __builtin_reduce_or(coincide) != 0;"),
)
def gather_one(  # type: ignore[empty-body]
    i: int,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> bool: ...


@wp.kernel(enable_backward=False)
def gather_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    left: wp.array[int],
) -> None:
    """`measures.gather_pairs`, whose functions handle changing rows and coincident particles."""
    block = wp.tid()
    rows_left = gather_block(
        block, awake, shared, particle_laws, material, position, velocity, pairs, left
    )
    if rows_left > 0:
        for thread in range(block * BLOCK, wp.min((block + 1) * BLOCK, awake.count[0])):
            i = awake.index[thread]
            if left[i] > 0:
                sort_row(shared, position, pairs, i)
                # Both ends of a pair must be computed by the same arithmetic, to the last bit.
                if gather_one(i, shared, particle_laws, material, position, velocity, pairs):
                    orient_row(shared, position, pairs, i)
                    measure_row(shared, particle_laws, material, velocity, pairs, i)


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
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None: ...


@wp.kernel(enable_backward=False)
def measure_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """`measures.measure_pairs`."""
    measure_block(wp.tid(), awake, shared, particle_laws, material, velocity, pairs)
