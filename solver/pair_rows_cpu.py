# SPDX-License-Identifier: GPL-3.0-or-later
"""The products of conjugate gradients for the CPU's vector units.

They take more than half of a frame. The kernels of `pair_rows` with the same names are the same
products for reading and for graphics cards; a test holds the two to the same result.
"""

import warp as wp

from .bond_law import Body, Clay
from .pair_rows import MOST_PAIRS, PairRows

# The compiler may use all that this processor has; sums may be reordered (see the pragmas).
wp.set_module_options({"cpu_compiler_flags": "-O3 -march=native"})

_WIDTH = wp.constant(MOST_PAIRS)

_ROW = """{
    #pragma clang fp reassociate(on) contract(fast)
    const int n = pairs.count.data[i];
    const int row = i * width;
    const int* __restrict__ other = pairs.other.data + row;
    const float* __restrict__ nx = pairs.direction_x.data + row;
    const float* __restrict__ ny = pairs.direction_y.data + row;
    const float* __restrict__ nz = pairs.direction_z.data + row;
    const float* __restrict__ slope = pairs.slope.data + row;
    const float* __restrict__ p = (const float*)direction.data;
    const float px = p[3 * i], py = p[3 * i + 1], pz = p[3 * i + 2];
"""


@wp.func_native(
    _ROW
    + """
    float total = 0.f;
    #pragma clang loop vectorize(enable) interleave(disable)
    for (int e = 0; e < n; e++) {
        const int j = 3 * other[e];
        const float dx = px - p[j], dy = py - p[j + 1], dz = pz - p[j + 2];
        total += slope[e] * (nx[e] * dx + ny[e] * dy + nz[e] * dz);
    }
    return total;
}"""
)
def press_row(i: int, width: int, pairs: PairRows, direction: wp.array[wp.vec3]) -> float: ...  # type: ignore[empty-body]


@wp.func_native(
    _ROW
    + """
    const float* __restrict__ stiffness = pairs.stiffness.data + row;
    const float* __restrict__ pressure = pressure_change.data;
    const float own = pressure[i];
    float ax = 0.f, ay = 0.f, az = 0.f;
    #pragma clang loop vectorize(enable) interleave(disable)
    for (int e = 0; e < n; e++) {
        const int k = other[e], j = 3 * k;
        const float dx = px - p[j], dy = py - p[j + 1], dz = pz - p[j + 2];
        const float closing = nx[e] * dx + ny[e] * dy + nz[e] * dz;
        const float pull = stiffness[e] * closing + slope[e] * (own + pressure[k]);
        ax += nx[e] * pull;
        ay += ny[e] * pull;
        az += nz[e] * pull;
    }
    return wp::vec3(ax, ay, az);
}"""
)
def multiply_row(
    i: int,
    width: int,
    pairs: PairRows,
    direction: wp.array[wp.vec3],
    pressure_change: wp.array[float],
) -> wp.vec3: ...


@wp.func_native("""{
    #pragma clang fp reassociate(on) contract(fast)
    const int n = pairs.count.data[i];
    const int row = i * width;
    const int* __restrict__ other = pairs.other.data + row;
    const float* __restrict__ nx = pairs.direction_x.data + row;
    const float* __restrict__ ny = pairs.direction_y.data + row;
    const float* __restrict__ nz = pairs.direction_z.data + row;
    const float* __restrict__ distance = pairs.distance.data + row;
    const float* __restrict__ length = pairs.length.data + row;
    float* __restrict__ next = pairs.distance_next.data + row;
    const float* __restrict__ v = (const float*)velocity.data;
    const float vx = v[3 * i], vy = v[3 * i + 1], vz = v[3 * i + 2];
    const float inverse_radius = 1.f / kernel_radius;
    float density = 0.f, stretch = 0.f, bonds = 0.f;
    #pragma clang loop vectorize(enable) interleave(disable)
    for (int e = 0; e < n; e++) {
        const int j = 3 * other[e];
        const float x = nx[e] * distance[e] + (v[j] - vx) * time_step;
        const float y = ny[e] * distance[e] + (v[j + 1] - vy) * time_step;
        const float z = nz[e] * distance[e] + (v[j + 2] - vz) * time_step;
        const float apart = __builtin_sqrtf(x * x + y * y + z * z);
        const float t = __builtin_fmaxf(1.f - apart * inverse_radius, 0.f);
        const float bonded = length[e] > 0.f ? 1.f : 0.f;
        next[e] = apart;
        density += t * t * t;
        stretch += bonded * (apart - length[e]);
        bonds += bonded;
    }
    return wp::vec3(density, stretch, bonds);
}""")
def measure_row(
    i: int,
    width: int,
    kernel_radius: float,
    time_step: float,
    pairs: PairRows,
    velocity: wp.array[wp.vec3],
) -> wp.vec3: ...


@wp.kernel(enable_backward=False)
def measure_pairs(clay: Clay, velocity: wp.array[wp.vec3], pairs: PairRows) -> None:
    """`pair_rows.measure_pairs`, a row at a time."""
    i = wp.tid()
    row = measure_row(i, _WIDTH, clay.kernel_radius, clay.time_step, pairs, velocity)
    pairs.mean_stretch[i] = row[1] / wp.max(row[2], 1.0)
    density = (1.0 + row[0]) * clay.inverse_rest_sum
    pairs.compression[i] = wp.max(density - 1.0, 0.0)


@wp.kernel(enable_backward=False)
def press_pairs(
    bodies: wp.array[Body],
    material: wp.array[int],
    time_step: float,
    pairs: PairRows,
    direction: wp.array[wp.vec3],
    pressure_change: wp.array[float],
) -> None:
    """`pair_rows.press_pairs`, a row at a time."""
    i = wp.tid()
    total = float(0.0)
    if pairs.compression[i] > 0.0:
        total = press_row(i, _WIDTH, pairs, direction)
    scale = bodies[material[i]].pressure_stiffness * time_step * time_step
    pressure_change[i] = total * scale


@wp.kernel(enable_backward=False)
def multiply_pairs(
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    pressure_change: wp.array[float],
    direction: wp.array[wp.vec3],
    product: wp.array[wp.vec3],
) -> None:
    """`pair_rows.multiply_pairs`, a row at a time."""
    i = wp.tid()
    row = multiply_row(i, _WIDTH, pairs, direction, pressure_change)
    product[i] = own_block[i] * direction[i] + row
