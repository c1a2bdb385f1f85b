# SPDX-License-Identifier: GPL-3.0-or-later
"""A smooth particle density on a sparse grid: blocks of 8³ nodes, only near particles.

Designed for the CPU's vector units: one row of a block is one vector. Lengths are in cells.
"""

import warp as wp

from .....solver.core.vector_units import OPTIONS, VECTORS

wp.set_module_options(OPTIONS)

NODES = 512
"""Number of nodes in a block, numbered (x · 8 + y) · 8 + z."""
MAX_COORDINATE = float(1 << 22)
"""Particles farther from the origin along any axis are ignored [cells]."""
LEVEL = 0.5
"""Density at the surface: half the interior density, so that flat faces are in the right place."""
THIN_DENSITY = 0.7
"""Particles with a lower density get more weight in compensation. Chosen so that a sheet of one
layer, a row and a single particle all keep their volume."""


@wp.struct
class Blocks:
    """The sparse grid. Block 0 is empty, and represents all missing blocks."""

    slot_key: wp.array[wp.int64]
    """Hash table: the key of the block in each slot, -1 if the slot is free."""
    slot_block: wp.array[int]
    """Hash table: the number of the block in each slot."""
    place: wp.array[wp.vec3i]
    """Position of each block [blocks]."""
    reached: wp.array[int]
    """One bit for each of the 27 neighboring blocks that the density reaches."""
    neighbor: wp.array2d[int]
    """Numbers of the 27 neighboring blocks, 0 if missing, at (x · 3 + y) · 3 + z; 13 is itself."""
    count: wp.array[int]
    """Number of blocks, including the empty one; exceeds the capacity if that was too small."""
    particle_block: wp.array[int]
    """Block of each particle, 0 if the particle is ignored."""
    mass: wp.array2d[float]
    """Mass at each node, 1 in the interior."""
    scratch: wp.array2d[float]
    density: wp.array2d[float]
    """Smoothed mass."""
    lowest: wp.array[float]
    """Minimum density in each block."""
    highest: wp.array[float]
    """Maximum density in each block."""


# A hash table with open addressing. Particles add their block, and blocks their neighbors.
@wp.func_native(
    """{
    typedef long long i64;
    const int room = blocks.place.shape[0], slots = blocks.slot_key.shape[0];
    i64* keys = blocks.slot_key.data;
    int* numbers = blocks.slot_block.data;
    int* places = (int*)blocks.place.data;
    int count = 1;
    for (int s = 0; s < slots; s++) keys[s] = -1;
    auto find = [&](int x, int y, int z, bool add) __attribute__((always_inline)) {
        const i64 half = 1 << 20, key = ((x + half) << 42) | ((y + half) << 21) | (z + half);
        unsigned s = (unsigned)(((unsigned long long)key * 0x9E3779B97F4A7C15ull) >> 32);
        for (s &= slots - 1; keys[s] != key; s = (s + 1) & (slots - 1)) {
            if (keys[s] >= 0) continue;
            if (!add) return 0;
            if (count < room) {
                keys[s] = key;
                numbers[s] = count;
                places[3 * count] = x;
                places[3 * count + 1] = y;
                places[3 * count + 2] = z;
                blocks.reached.data[count] = 0;
            }
            return count++;
        }
        return numbers[s];
    };
    // The density of a particle reaches nodes up to 4 below and 5 above that of its cell.
    auto reach = [](int n) __attribute__((always_inline)) {
        const int l = n & 7;
        return 2 | (l < 5 ? 1 : 0) | (l > 2 ? 4 : 0);
    };
    int last = 0, lx = 0, ly = 0, lz = 0;
    for (int i = 0; i < particle_count; i++) {
        int n[3];
        bool near = true;
        for (int k = 0; k < 3; k++) {
            const float c = inverse_cell * ((const float*)position.data)[3 * (i64)i + k];
            near = near && c > -max_coordinate && c < max_coordinate;
            n[k] = near ? (int)__builtin_floorf(c) : 0;
        }
        blocks.particle_block.data[i] = 0;
        if (!near) continue;
        const int x = n[0] >> 3, y = n[1] >> 3, z = n[2] >> 3;
        if (!last || x != lx || y != ly || z != lz) {
            last = find(x, y, z, true);
            lx = x, ly = y, lz = z;
        }
        if (count > room) break;
        blocks.particle_block.data[i] = last;
        const int a = reach(n[0]), b = reach(n[1]), c = reach(n[2]);
        const int row = (b & 1 ? c : 0) | (b & 2 ? c << 3 : 0) | (b & 4 ? c << 6 : 0);
        blocks.reached.data[last] |=
            (a & 1 ? row : 0) | (a & 2 ? row << 9 : 0) | (a & 4 ? row << 18 : 0);
    }
    const int own = count;
    for (int b = 1; b < own && count <= room; b++)
        for (int k = 0; k < 27; k++)
            if (blocks.reached.data[b] >> k & 1)
                find(places[3 * b] + k / 9 - 1, places[3 * b + 1] + k / 3 % 3 - 1,
                     places[3 * b + 2] + k % 3 - 1, true);
    blocks.count.data[0] = count;
    if (count > room) return;
    for (int k = 0; k < 27; k++) blocks.neighbor.data[k] = 0;
    for (int b = 1; b < count; b++)
        for (int k = 0; k < 27; k++)
            blocks.neighbor.data[27 * b + k] =
                find(places[3 * b] + k / 9 - 1, places[3 * b + 1] + k / 3 % 3 - 1,
                     places[3 * b + 2] + k % 3 - 1, false);
}"""
)
def find_all_blocks(  # type: ignore[empty-body]
    particle_count: int,
    position: wp.array[wp.vec3],
    inverse_cell: float,
    max_coordinate: float,
    blocks: Blocks,
) -> None: ...


@wp.kernel(enable_backward=False)
def find_blocks(
    particle_count: int, position: wp.array[wp.vec3], inverse_cell: float, blocks: Blocks
) -> None:
    """Find the blocks that the density reaches, and the neighbors of each."""
    find_all_blocks(particle_count, position, inverse_cell, wp.static(MAX_COORDINATE), blocks)


CORNERS = """
    typedef long long i64;
    int node[8];
    float share[8];
    // The eight nodes around a particle, and the share of its mass that each gets.
    auto spread = [&](int i) __attribute__((always_inline)) {
        const int b = blocks.particle_block.data[i];
        const int* around = blocks.neighbor.data + 27 * (i64)b;
        int low[3];
        float part[3];
        for (int k = 0; k < 3; k++) {
            const float c = inverse_cell * ((const float*)position.data)[3 * (i64)i + k];
            const float f = __builtin_floorf(c);
            low[k] = (int)f & 7;
            part[k] = c - f;
        }
        for (int k = 0; k < 8; k++) {
            const int x = low[0] + (k >> 2), y = low[1] + (k >> 1 & 1), z = low[2] + (k & 1);
            const int home = around[13 + 9 * (x >> 3) + 3 * (y >> 3) + (z >> 3)];
            node[k] = home * 512 + ((x & 7) * 8 + (y & 7)) * 8 + (z & 7);
            share[k] = (k >> 2 ? part[0] : 1.f - part[0]) * (k >> 1 & 1 ? part[1] : 1.f - part[1])
                     * (k & 1 ? part[2] : 1.f - part[2]);
        }
    };
"""
"""C++ code that finds the nodes around a particle."""


@wp.func_native(
    "{"
    + CORNERS
    + """
    for (int b = 0; b < blocks.count.data[0]; b++)
        for (int k = 0; k < 512; k++) blocks.mass.data[512 * (i64)b + k] = 0.f;
    for (int i = 0; i < particle_count; i++) {
        if (blocks.particle_block.data[i] == 0) continue;
        spread(i);
        float weight = 1.f;
        if (thin > 0.f) {
            float density = 0.f;
            for (int k = 0; k < 8; k++) density += share[k] * blocks.density.data[node[k]];
            weight = density < thin ? __builtin_powf(thin / density, 1.1f) : 1.f;
        }
        for (int k = 0; k < 8; k++) blocks.mass.data[node[k]] += weight * share[k] * amount;
    }
}"""
)
def splat_all(  # type: ignore[empty-body]
    particle_count: int,
    position: wp.array[wp.vec3],
    inverse_cell: float,
    amount: float,
    thin: float,
    blocks: Blocks,
) -> None: ...


@wp.kernel(enable_backward=False)
def splat_mass(
    particle_count: int,
    position: wp.array[wp.vec3],
    inverse_cell: float,
    amount: float,
    thin: float,
    blocks: Blocks,
) -> None:
    """Distribute the particles' mass to the nodes.

    Args:
        particle_count: Number of particles.
        position: Particle positions.
        inverse_cell: Number of cells per unit of length.
        amount: Mass of a particle.
        thin: Particles with a lower density before get more weight; 0 for equal weights.
        blocks: The grid.
    """
    splat_all(particle_count, position, inverse_cell, amount, thin, blocks)


# A binomial kernel of nine nodes, with a variance of two cells². Along x and y, where rows are
# whole vectors, it results from adding neighbors eight times.
BLUR = (
    VECTORS
    + """
    const int step = axis == 0 ? 9 : axis == 1 ? 3 : 1;
    const int* around = blocks.neighbor.data + 27 * (long long)block + 13;
    const float* a = source.data + 512 * (long long)around[-step];
    const float* b = source.data + 512 * (long long)block;
    const float* c = source.data + 512 * (long long)around[step];
    float* out = target.data + 512 * (long long)block;
    f8 low = (f8)(1e30f), high = (f8)(-1e30f);
    if (axis < 2) {
        const int along = axis == 0 ? 64 : 8, across = axis == 0 ? 8 : 64;
        for (int line = 0; line < 8; line++) {
            const int begin = line * across;
            f8 r[16];
            for (int k = 0; k < 4; k++) {
                r[k] = load(a + begin + (4 + k) * along);
                r[12 + k] = load(c + begin + k * along);
            }
            for (int k = 0; k < 8; k++) r[4 + k] = load(b + begin + k * along);
            #pragma clang loop unroll(full)
            for (int n = 15; n > 7; n--)
                #pragma clang loop unroll(full)
                for (int k = 0; k < n; k++) r[k] += r[k + 1];
            for (int k = 0; k < 8; k++) store(out + begin + k * along, r[k] * (1.f / 256.f));
        }
    } else {
        for (int row = 0; row < 512; row += 8) {
            const f8 l = load(a + row), m = load(b + row), n = load(c + row);
            #define AT(v, w, k) __builtin_shufflevector( \\
                v, w, k, k + 1, k + 2, k + 3, k + 4, k + 5, k + 6, k + 7)
            const f8 sum = 70.f * m + 56.f * (AT(l, m, 7) + AT(m, n, 1))
                         + 28.f * (AT(l, m, 6) + AT(m, n, 2)) + 8.f * (AT(l, m, 5) + AT(m, n, 3))
                         + (AT(l, m, 4) + AT(m, n, 4));
            const f8 result = sum * (1.f / 256.f);
            #undef AT
            store(out + row, result);
            low = minimum(low, result);
            high = maximum(high, result);
        }
        float l = low[0], h = high[0];
        for (int k = 1; k < 8; k++) {
            l = low[k] < l ? low[k] : l;
            h = high[k] > h ? high[k] : h;
        }
        blocks.lowest.data[block] = l;
        blocks.highest.data[block] = h;
    }
}"""
)


@wp.func_native(BLUR)
def blur_block(  # type: ignore[empty-body]
    block: int, axis: int, source: wp.array2d[float], target: wp.array2d[float], blocks: Blocks
) -> None: ...


@wp.kernel(enable_backward=False)
def blur(axis: int, source: wp.array2d[float], target: wp.array2d[float], blocks: Blocks) -> None:
    """Smooth a block along an axis."""
    blur_block(wp.tid(), axis, source, target, blocks)
