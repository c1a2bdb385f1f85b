# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of `products` for the CPU's vector units: eight pairs of a row at a time.

Most of a frame's time is spent in them. A test holds the two to the same results.
"""

import warp as wp

from ...core.awake import Awake
from ...core.vector_units import OPTIONS, over_block
from ..law import FORMULAS
from ..law_data import ParticleLaw, SharedLaw
from .rows import ROW, PairRows

wp.set_module_options(OPTIONS)

_DIRECTION = """
    const float px = p[4 * i], py = p[4 * i + 1], pz = p[4 * i + 2];
"""


@wp.func_native(
    over_block(
        FORMULAS
        + """
    float* p = (float*)direction.data;
""",
        """
    // Where nothing is compressed, the change is already zero.
    if (pairs.condition.data[i][0] <= 0.f) continue;
"""
        + ROW
        + _DIRECTION
        + """
    f8 total = zero;
    for (int e = 0; e < end; e += 8) {
        f8 x, y, z, w;
        pick4(p, other + e, x, y, z, w);
        total += load(slope + e)
            * (load(nx + e) * (px - x) + load(ny + e) * (py - y) + load(nz + e) * (pz - z));
    }
    const auto& own = particle_laws.data[material.data[i]];
    p[4 * i + 3] = sum(total) * pressure_tangent(own.pressure_stiffness);
""",
    )
)
def press_block(
    block: int,
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    pairs: PairRows,
    direction: wp.array[wp.vec4],
) -> None: ...


@wp.kernel(enable_backward=False)
def press_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    pairs: PairRows,
    direction: wp.array[wp.vec4],
) -> None:
    """`products.press_pairs`."""
    press_block(wp.tid(), awake, shared, particle_laws, material, pairs, direction)


@wp.func_native(
    over_block(
        FORMULAS
        + """
    const float* __restrict__ p = (const float*)direction.data;
    double energy = 0.0;
""",
        ROW
        + _DIRECTION
        + """
    const float own = p[4 * i + 3];
    f8 ax = zero, ay = zero, az = zero;
    for (int e = 0; e < end; e += 8) {
        f8 x, y, z, pressure;
        pick4(p, other + e, x, y, z, pressure);
        const f8 dx = load(nx + e), dy = load(ny + e), dz = load(nz + e);
        const f8 closing = dx * (px - x) + dy * (py - y) + dz * (pz - z);
        const f8 pull =
            tangent_pull(load(stiffness + e), closing, load(slope + e), own + pressure);
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
    shared: SharedLaw,
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    direction: wp.array[wp.vec4],
    product: wp.array[wp.vec3],
    curvature: wp.array2d[wp.float64],
    iteration: int,
) -> None: ...


@wp.kernel(enable_backward=False)
def multiply_pairs(
    awake: Awake,
    shared: SharedLaw,
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    direction: wp.array[wp.vec4],
    product: wp.array[wp.vec3],
    curvature: wp.array2d[wp.float64],
    iteration: int,
) -> None:
    """`products.multiply_pairs`."""
    multiply_block(
        wp.tid(),
        awake,
        shared,
        pairs,
        own_block,
        direction,
        product,
        curvature,
        iteration,
    )
