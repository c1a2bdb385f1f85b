# SPDX-License-Identifier: GPL-3.0-or-later
"""A net of quads around the region where the density exceeds the level.

Dual to the grid: one vertex in every cell that the surface cuts, and one quad around every grid
edge that it crosses (Gibson, "Constrained Elastic Surface Nets", MICCAI 1998,
doi:10.1007/BFb0056277).
"""

import warp as wp

from .....solver.core.vector_units import OPTIONS
from .field import LEVEL, Blocks

wp.set_module_options(OPTIONS)


@wp.struct
class Net:
    """The net, and the cells it passes through. A cell has the number of its lowest node."""

    one_sheet: wp.array[wp.uint8]
    """For each pattern of inside corners, whether a single sheet of surface cuts the cell."""
    cut: wp.array2d[wp.uint8]
    """One bit for each cell of a block that the surface cuts, 64 rows per block."""
    painted: wp.array[int]
    """Number of each block among those with colors, starting at 1; 0 for the others."""
    shows: wp.array[wp.uint8]
    """Whether a block's particles contribute to the colors of any block."""
    count: wp.array[int]
    """Numbers of vertices, blocks with colors, edges and quads."""
    vertex: wp.array2d[int]
    """Number of the vertex in each cut cell."""
    cell: wp.array[int]
    """Block · 512 + cell of each vertex."""
    pattern: wp.array[wp.uint8]
    """Bits of the inside corners of each vertex's cell."""
    position: wp.array[wp.vec4]
    """Positions of the vertices [cells]."""
    neighbor: wp.array2d[int]
    """Up to 6 vertices that share an edge with each vertex, padded with the vertex itself."""
    edge: wp.array2d[int]
    """Vertices at both ends of each edge."""
    edge_of: wp.array2d[int]
    """Edges from each vertex through the upper faces of its cell along x, y and z."""
    quad: wp.array2d[int]
    """Vertices of each quad, counter-clockwise seen from outside."""
    quad_edge: wp.array2d[int]
    """Edge from each corner of a quad to the next."""
    paint: wp.array2d[wp.vec4]
    """Sums of particle colors times shares, at nodes."""
    color: wp.array[wp.vec4]
    """Linear RGBA of the vertices."""
    scratch: wp.array2d[wp.vec4]
    """Two buffers for values of the vertices."""
    kept: wp.array[wp.vec4]
    """A third buffer."""


NODE_LOOKUP = """
    // The node at x, y, z from -1 to 8 relative to a block, which may be in a neighboring block.
    auto node_at = [&](i64 b, int x, int y, int z) __attribute__((always_inline)) {
        const i64 home = blocks.neighbor.data[27 * b + 9 * ((x + 8) >> 3) + 3 * ((y + 8) >> 3)
                                            + ((z + 8) >> 3)];
        return 512 * home + (x & 7) * 64 + (y & 7) * 8 + (z & 7);
    };
    auto is_inside = [&](i64 node) __attribute__((always_inline)) {
        return blocks.density.data[node] >= level ? 1 : 0;
    };
    auto pattern_of = [&](i64 b, int x, int y, int z) {
        int pattern = 0;
        for (int k = 0; k < 8; k++)
            pattern |= is_inside(node_at(b, x + (k >> 2), y + (k >> 1 & 1), z + (k & 1))) << k;
        return pattern;
    };
"""


# Touching sheets of surface are separated until a single sheet cuts each cell: cells with two lose
# their inside corner of least density. So the net is closed and manifold (see
# `solver.geometry.surface_net`).
@wp.func_native(
    "{ typedef long long i64;"
    + NODE_LOOKUP
    + """
    const int block_count = blocks.count.data[0];
    typedef unsigned char u8;
    u8* cut = net.cut.data;
    bool ambiguous = false;
    for (i64 b = 0; b < block_count; b++) {
        for (int row = 0; row < 64; row++) cut[64 * b + row] = 0;
        if (b == 0) continue;
        float low = 1e30f, high = -1e30f;
        for (int k = 0; k < 8; k++) {
            const int neighbor = blocks.neighbor.data[27 * b + 13 + 9 * (k >> 2) + 3 * (k >> 1 & 1)
                                                  + (k & 1)];
            const float l = blocks.lowest.data[neighbor], h = blocks.highest.data[neighbor];
            low = l < low ? l : low;
            high = h > high ? h : high;
        }
        if (high < level || low >= level) continue;
        int inside[9][9];
        for (int x = 0; x < 9; x++) for (int y = 0; y < 9; y++) {
            const float* line = blocks.density.data + node_at(b, x, y, 0);
            int bits = 0;
            for (int z = 0; z < 8; z++) bits |= (line[z] >= level ? 1 : 0) << z;
            inside[x][y] = bits | is_inside(node_at(b, x, y, 8)) << 8;
        }
        for (int x = 0; x < 8; x++) for (int y = 0; y < 8; y++) {
            const int *here = inside[x] + y, *next = inside[x + 1] + y;
            const int r[4] = {here[0], here[1], next[0], next[1]};
            const int any = r[0] | r[1] | r[2] | r[3], all = r[0] & r[1] & r[2] & r[3];
            const int bits = (any | any >> 1) & ~(all & all >> 1) & 255;
            cut[64 * b + 8 * x + y] = (u8)bits;
            for (int left = bits; left; left &= left - 1) {
                const int z = __builtin_ctz(left);
                int pattern = 0;
                for (int k = 0; k < 4; k++) pattern |= (r[k] >> z & 3) << (2 * k);
                ambiguous = ambiguous || !net.one_sheet.data[pattern];
            }
        }
    }
    while (ambiguous) {
        ambiguous = false;
        for (i64 b = 1; b < block_count; b++) for (int row = 0; row < 64; row++)
            for (int left = cut[64 * b + row]; left; left &= left - 1) {
                const int x = row >> 3, y = row & 7, z = __builtin_ctz(left);
                if (net.one_sheet.data[pattern_of(b, x, y, z)]) continue;
                ambiguous = true;
                int shallowest = 0;
                float least = 1e30f;
                for (int k = 0; k < 8; k++) {
                    const float d = blocks.density.data[
                        node_at(b, x + (k >> 2), y + (k >> 1 & 1), z + (k & 1))];
                    if (d >= level && d < least) least = d, shallowest = k;
                }
                const int nx = x + (shallowest >> 2), ny = y + (shallowest >> 1 & 1),
                          nz = z + (shallowest & 1);
                blocks.density.data[node_at(b, nx, ny, nz)] = 0.999f * level;
                // Update the cells around that corner, each in the block it belongs to.
                for (int k = 0; k < 8; k++) {
                    const i64 cell = node_at(b, nx - (k >> 2), ny - (k >> 1 & 1), nz - (k & 1));
                    const i64 home = cell >> 9;
                    if (home == 0) continue;
                    const int pattern = pattern_of(home, cell >> 6 & 7, cell >> 3 & 7, cell & 7);
                    const u8 bit = (u8)(1 << (cell & 7));
                    u8& bits = cut[cell >> 3];
                    bits = pattern == 0 || pattern == 255 ? bits & ~bit : bits | bit;
                }
            }
    }
    int vertex_count = 0, painted_count = 0;
    for (i64 b = 0; b < block_count; b++) net.painted.data[b] = 0;
    for (i64 b = 1; b < block_count; b++) {
        int here = 0;
        for (int row = 0; row < 64; row++) here += __builtin_popcount(cut[64 * b + row]);
        vertex_count += here;
        for (int k = 0; here && k < 8; k++) {
            const int neighbor = blocks.neighbor.data[27 * b + 13 + 9 * (k >> 2) + 3 * (k >> 1 & 1)
                                                  + (k & 1)];
            int& number = net.painted.data[neighbor];
            if (neighbor && !number) number = ++painted_count;
        }
    }
    for (i64 b = 0; b < block_count; b++) {
        u8 shows = 0;
        for (int k = 0; k < 8; k++)
            shows |= net.painted.data[blocks.neighbor.data[
                27 * b + 13 + 9 * (k >> 2) + 3 * (k >> 1 & 1) + (k & 1)]] != 0;
        net.shows.data[b] = shows;
    }
    net.count.data[0] = vertex_count;
    net.count.data[1] = painted_count;
}"""
)
def cut_all_cells(level: float, blocks: Blocks, net: Net) -> None: ...  # type: ignore[empty-body]


@wp.kernel(enable_backward=False)
def cut_cells(blocks: Blocks, net: Net) -> None:
    """Find the cells that the surface cuts, and ensure that one sheet cuts each."""
    cut_all_cells(wp.static(LEVEL), blocks, net)


@wp.func_native(
    "{ typedef long long i64;"
    + NODE_LOOKUP
    + """
    int v = 0;
    for (i64 b = 1; b < blocks.count.data[0]; b++) for (int row = 0; row < 64; row++)
        for (int left = net.cut.data[64 * b + row]; left; left &= left - 1) {
            const int x = row >> 3, y = row & 7, z = __builtin_ctz(left);
            float d[8];
            int pattern = 0;
            for (int k = 0; k < 8; k++) {
                d[k] = blocks.density.data[node_at(b, x + (k >> 2), y + (k >> 1 & 1), z + (k & 1))];
                pattern |= (d[k] >= level ? 1 : 0) << k;
            }
            // The mean of the points where the surface crosses the cell's edges.
            float sum[3] = {0.f, 0.f, 0.f};
            int crossings = 0;
            for (int axis = 0; axis < 3; axis++) {
                const int bit = 4 >> axis;
                for (int k = 0; k < 8; k++) {
                    if (k & bit || (pattern >> k & 1) == (pattern >> (k | bit) & 1)) continue;
                    const float part = (level - d[k]) / (d[k | bit] - d[k]);
                    sum[0] += axis == 0 ? part : (float)(k >> 2);
                    sum[1] += axis == 1 ? part : (float)(k >> 1 & 1);
                    sum[2] += axis == 2 ? part : (float)(k & 1);
                    crossings++;
                }
            }
            const int* place = (const int*)blocks.place.data + 3 * b;
            float* p = (float*)net.position.data + 4 * (i64)v;
            const int at[3] = {x, y, z};
            for (int k = 0; k < 3; k++)
                p[k] = (float)(8 * (place[k] - origin[k]) + at[k]) + sum[k] / crossings;
            p[3] = 0.f;
            const i64 cell = 512 * b + 8 * row + z;
            net.vertex.data[cell] = v;
            net.cell.data[v] = (int)cell;
            net.pattern.data[v] = (unsigned char)pattern;
            v++;
        }
    // Corners of a cell's lower face along each axis; for the upper face, shift by the axis' bit.
    const int lower[3] = {0x0f, 0x33, 0x55};
    int edges = 0;
    for (i64 u = 0; u < v; u++) {
        const i64 cell = net.cell.data[u], b = cell >> 9;
        const int at[3] = {(int)(cell >> 6 & 7), (int)(cell >> 3 & 7), (int)(cell & 7)};
        const int pattern = net.pattern.data[u];
        int* neighbor = net.neighbor.data + 6 * u;
        for (int axis = 0; axis < 3; axis++) for (int up = 0; up < 2; up++) {
            const int face = up ? lower[axis] << (4 >> axis) : lower[axis];
            int& other = neighbor[2 * axis + up];
            other = (int)u;
            if (up) net.edge_of.data[3 * u + axis] = -1;
            if ((pattern & face) == 0 || (pattern & face) == face) continue;
            int to[3] = {at[0], at[1], at[2]};
            to[axis] += up ? 1 : -1;
            other = net.vertex.data[node_at(b, to[0], to[1], to[2])];
            if (!up) continue;
            net.edge.data[2 * (i64)edges] = (int)u;
            net.edge.data[2 * (i64)edges + 1] = other;
            net.edge_of.data[3 * u + axis] = edges++;
        }
    }
    i64 quads = 0;
    for (i64 u = 0; u < v; u++) {
        const i64 cell = net.cell.data[u], b = cell >> 9;
        const int at[3] = {(int)(cell >> 6 & 7), (int)(cell >> 3 & 7), (int)(cell & 7)};
        const int pattern = net.pattern.data[u];
        for (int axis = 0; axis < 3; axis++) {
            const int within = pattern & 1;
            if (within == (pattern >> (4 >> axis) & 1)) continue;
            const int p = (axis + 1) % 3, q = (axis + 2) % 3;
            int around[4] = {(int)u, 0, 0, 0};
            for (int k = 1; k < 4; k++) {
                int to[3] = {at[0], at[1], at[2]};
                to[p] -= k < 3;
                to[q] -= k > 1;
                around[k] = net.vertex.data[node_at(b, to[0], to[1], to[2])];
            }
            const int* edge_of = net.edge_of.data;
            const int sides[4] = {edge_of[3 * (i64)around[1] + p], edge_of[3 * (i64)around[2] + q],
                                  edge_of[3 * (i64)around[2] + p], edge_of[3 * (i64)around[3] + q]};
            for (int k = 0; k < 4; k++) {
                net.quad.data[4 * quads + k] = around[within ? k : -k & 3];
                net.quad_edge.data[4 * quads + k] = sides[within ? k : 3 - k];
            }
            quads++;
        }
    }
    net.count.data[2] = edges;
    net.count.data[3] = (int)quads;
}"""
)
def join_all(  # type: ignore[empty-body]
    level: float, origin: wp.vec3i, blocks: Blocks, net: Net
) -> None: ...


@wp.kernel(enable_backward=False)
def join_vertices(origin: wp.vec3i, blocks: Blocks, net: Net) -> None:
    """Put a vertex in each cut cell, and connect those of cells that share a face.

    Positions are relative to the corner of the block ``origin``, to preserve precision.
    """
    join_all(wp.static(LEVEL), origin, blocks, net)
