# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of `forces` for the CPU's vector units: eight pairs of a row at a time.

The kernels of the same names in `forces` are the same passes, for reading and for GPUs; tests hold
the two to the same results. The formulas of both are those of `law`. Lanes beyond the last pair of
a row get no stiffness and no slope, so that they add nothing here or in a product.
"""

import warp as wp

from ...core.awake import Awake
from ...core.vector_units import OPTIONS, over_block
from ..law import FORMULAS
from ..law_data import PairLaw, ParticleLaw, SharedLaw
from .rows import ROW, PairRows

wp.set_module_options(OPTIONS)

# The law of each of eight pairs.
_LAW_SETUP = (
    FORMULAS
    + """
    const bool uniform = shared.material_count == 1;
    const float* __restrict__ conditions = (const float*)pairs.condition.data;
    f8 law_stiffness = (f8)(pair_laws.data[0].stiffness);
    f8 law_tension = (f8)(pair_laws.data[0].tension_stretch);
    auto take_laws = [&](int i, const int* other) __attribute__((always_inline)) {
        const auto* laws = pair_laws.data + (long long)material.data[i] * shared.material_count;
        for (int l = 0; l < 8; l++) {
            const auto& law = laws[material.data[other[l]]];
            law_stiffness[l] = law.stiffness;
            law_tension[l] = law.tension_stretch;
        }
    };
"""
)


@wp.func_native(
    over_block(
        _LAW_SETUP,
        ROW
        + """
    const auto& own = particle_laws.data[material.data[i]];
    const float* condition = conditions + 4 * (long long)i;
    const float own_compression = condition[0], own_dilation = 0.5f * condition[1];
    const float own_share = 0.5f * condition[2], own_damping = 0.5f * condition[3];
    const float own_pressure = own.pressure_stiffness * own_compression;
    f8 other_stiffness = (f8)(own.pressure_stiffness);
    f8 fx = zero, fy = zero, fz = zero, sx = zero, sy = zero, sz = zero;
    f8 xx = zero, xy = zero, xz = zero, yy = zero, yz = zero, zz = zero;
    for (int e = 0; e < end; e += 8) {
        if (!uniform) {
            take_laws(i, other + e);
            for (int l = 0; l < 8; l++) {
                const auto& law = particle_laws.data[material.data[other[e + l]]];
                other_stiffness[l] = law.pressure_stiffness;
            }
        }
        const i8 live = lanes + e < acting;
        const f8 apart = load(next + e), rest = load(rests + e);
        const f8 x = load(nx + e), y = load(ny + e), z = load(nz + e);
        const f8 a = live ? kernel_slope(apart) : zero;
        f8 compression, dilation, share, damping;
        pick4(conditions, other + e, compression, dilation, share, damping);
        dilation = own_dilation + 0.5f * dilation;
        share = own_share + 0.5f * share;
        damping = live ? own_damping + 0.5f * damping : zero;
        const i8 bonded = live & (rest > 0.f);
        f8 softening;
        const i8 pressed = own_compression + compression > 0.f;
        const f8 flowed = flow_bond(law_tension, rest, apart, dilation, share,
            pressed, softening);
        const f8 bond = bonded ? law_stiffness * bond_hold(rest) : zero;
        const f8 pressures = own_pressure + other_stiffness * compression;
        const f8 parted = apart - load(distance + e);
        const f8 pull = pair_pull(damping, parted, pressures, a, bond, apart - flowed);
        const f8 k = pair_tangent(bond, softening, damping);
        store(stiffness + e, k);
        store(slope + e, a);
        const f8 w = k + (compression > 0.f ? pressure_tangent(other_stiffness) * a * a : zero);
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
    const float s = own_compression > 0.f ? pressure_tangent(own.pressure_stiffness) : 0.f;
    const float bxy = sum(xy) + s * px * py, bxz = sum(xz) + s * px * pz;
    const float byz = sum(yz) + s * py * pz;
    float* entry = (float*)diagonal.data + 9 * (long long)i;
    entry[0] = own.mass + sum(xx) + s * px * px;
    entry[1] = entry[3] = bxy;
    entry[2] = entry[6] = bxz;
    entry[4] = own.mass + sum(yy) + s * py * py;
    entry[5] = entry[7] = byz;
    entry[8] = own.mass + sum(zz) + s * pz * pz;
    const float* free = (const float*)velocity_free.data + 3 * (long long)i;
    const float* now = (const float*)velocity.data + 3 * (long long)i;
    float* missing = (float*)residual.data + 3 * (long long)i;
    missing[0] = (free[0] - now[0]) * own.mass + sum(fx) * dt;
    missing[1] = (free[1] - now[1]) * own.mass + sum(fy) * dt;
    missing[2] = (free[2] - now[2]) * own.mass + sum(fz) * dt;
""",
    )
)
def sum_forces_block(
    block: int,
    awake: Awake,
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    particle_laws: wp.array[ParticleLaw],
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
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    velocity_free: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
) -> None:
    """`forces.sum_forces`."""
    sum_forces_block(
        wp.tid(),
        awake,
        shared,
        pair_laws,
        particle_laws,
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
        f8 flowed = flow_bond(law_tension, rest, apart, dilation, share,
            pressed, softening);
        flowed = bond_breaks(apart, flowed) ? zero : flowed;
        const i8 bonded = (lanes + e < acting) & (rest > 0.f);
        store(rests + e, bonded ? flowed : rest);
    }
""",
    )
)
def flow_block(
    block: int,
    awake: Awake,
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None: ...


@wp.kernel(enable_backward=False)
def flow_pairs(
    awake: Awake,
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """`forces.flow_pairs`."""
    flow_block(wp.tid(), awake, shared, pair_laws, material, velocity, pairs)
