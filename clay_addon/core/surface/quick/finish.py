# SPDX-License-Identifier: GPL-3.0-or-later
"""Finishing a net: smoothing away bumps, and coloring it like the particles below it."""

import warp as wp

from .....solver.core.vector_units import OPTIONS
from .field import CORNERS, LEVEL, Blocks
from .net import NODE_LOOKUP, Net

wp.set_module_options(OPTIONS)


# With B the blur, 2 B - B B flattens bumps like B but hardly shrinks thin parts.
@wp.func_native(
    """{
    typedef float f4 __attribute__((ext_vector_type(4)));
    const int count = net.count.data[0];
    auto blur = [&](const f4* from, f4* to) __attribute__((always_inline)) {
        for (int v = 0; v < count; v++) {
            const int* neighbor = net.neighbor.data + 6 * (long long)v;
            const f4 own = from[v];
            f4 sum = (f4)(0.f);
            int others = 0;
            for (int k = 0; k < 6; k++) {
                sum += from[neighbor[k]];
                others += neighbor[k] != v;
            }
            to[v] = 0.5f * own + (0.5f / others) * (sum - (6 - others) * own);
        }
    };
    f4 *value = (f4*)values.data, *a = (f4*)net.scratch.data, *b = a + net.scratch.shape[1];
    for (int pass = 0; pass < passes; pass++)
        blur(pass ? (pass & 1 ? a : b) : value, pass & 1 ? b : a);
    f4 *once = passes & 1 ? a : b, *spare = passes & 1 ? b : a;
    if (max_change == 0.f) {
        for (int v = 0; v < count; v++) value[v] = once[v];
        return;
    }
    // The result of the first half is needed at the end, so keep it in the third buffer.
    f4* kept = (f4*)net.kept.data;
    for (int v = 0; v < count; v++) kept[v] = once[v];
    for (int pass = 0; pass < passes; pass++) {
        blur(once, spare);
        f4* other = once;
        once = spare;
        spare = other;
    }
    for (int v = 0; v < count; v++) {
        f4 change = 2.f * kept[v] - once[v] - value[v];
        const f4 square = change * change;
        const float length = __builtin_sqrtf(square.x + square.y + square.z);
        value[v] += length > max_change ? (max_change / length) * change : change;
    }
}"""
)
def smooth_all(  # type: ignore[empty-body]
    passes: int, max_change: float, values: wp.array[wp.vec4], net: Net
) -> None: ...


@wp.kernel(enable_backward=False)
def smooth(passes: int, max_change: float, values: wp.array[wp.vec4], net: Net) -> None:
    """Smooth the vertices' values along the net.

    Args:
        passes: Number of passes; each moves values halfway toward the mean of their neighbors.
        max_change: Values change by no more than this, and thin parts keep their volume; 0 for a
            plain blur.
        values: Values of the vertices, changed in place.
        net: The net.
    """
    smooth_all(passes, max_change, values, net)


@wp.func_native(
    "{"
    + CORNERS
    + NODE_LOOKUP
    + """
    typedef float f4 __attribute__((ext_vector_type(4)));
    typedef f4 f4u __attribute__((aligned(4)));
    f4u* paint = (f4u*)net.paint.data;
    float* weights = blocks.mass.data;
    for (i64 b = 0; b < blocks.count.data[0]; b++) {
        if (!net.painted.data[b]) continue;
        for (int k = 0; k < 512; k++) {
            paint[512 * (i64)net.painted.data[b] + k] = (f4)(0.f);
            weights[512 * b + k] = 0.f;
        }
    }
    for (int i = 0; i < particle_count; i++) {
        const int home = blocks.particle_block.data[i];
        if (!home || !net.shows.data[home]) continue;
        const f4 own = *(const f4u*)((const float*)color.data + 4 * (i64)i);
        const f4 finite = own - own;
        if (!(finite.x + finite.y + finite.z + finite.w == 0.f)) continue;
        spread(i);
        for (int k = 0; k < 8; k++) {
            const int slot = net.painted.data[node[k] >> 9];
            if (!slot) continue;
            paint[512 * (i64)slot + (node[k] & 511)] += share[k] * own;
            weights[node[k]] += share[k];
        }
    }
    for (i64 v = 0; v < net.count.data[0]; v++) {
        const i64 cell = net.cell.data[v];
        int at[3] = {(int)(cell >> 6 & 7), (int)(cell >> 3 & 7), (int)(cell & 7)};
        // The outermost particles are about one cell below the surface.
        float slope[3];
        for (int axis = 0; axis < 3; axis++) {
            slope[axis] = 0.f;
            for (int k = 0; k < 8; k++)
                slope[axis] += (k & (4 >> axis) ? 1.f : -1.f) * blocks.density.data[
                    node_at(cell >> 9, at[0] + (k >> 2), at[1] + (k >> 1 & 1), at[2] + (k & 1))];
        }
        const float length = __builtin_sqrtf(
            slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2]) + 1e-20f;
        for (int axis = 0; axis < 3; axis++)
            at[axis] += (int)__builtin_rintf(slope[axis] / length);
        f4 sum = (f4)(0.f);
        float weight = 0.f;
        for (int wider = 0; wider < 4 && weight < 1e-3f; wider++)
            for (int x = -wider; x < 2 + wider; x++) for (int y = -wider; y < 2 + wider; y++)
                for (int z = -wider; z < 2 + wider; z++) {
                    const i64 n = node_at(cell >> 9, at[0] + x, at[1] + y, at[2] + z);
                    const int slot = net.painted.data[n >> 9];
                    if (!slot) continue;
                    sum += paint[512 * (i64)slot + (n & 511)];
                    weight += weights[n];
                }
        f4u* out = (f4u*)net.color.data + v;
        if (weight > 0.f) *out = sum / weight;
        else *out = v ? out[-1] : (f4)(1.f);
    }
}"""
)
def paint_all(  # type: ignore[empty-body]
    particle_count: int,
    position: wp.array[wp.vec3],
    color: wp.array[wp.vec4],
    inverse_cell: float,
    level: float,
    blocks: Blocks,
    net: Net,
) -> None: ...


@wp.kernel(enable_backward=False)
def paint_vertices(
    particle_count: int,
    position: wp.array[wp.vec3],
    color: wp.array[wp.vec4],
    inverse_cell: float,
    blocks: Blocks,
    net: Net,
) -> None:
    """Average the colors of the particles around each vertex."""
    paint_all(particle_count, position, color, inverse_cell, wp.static(LEVEL), blocks, net)
