# SPDX-License-Identifier: GPL-3.0-or-later
"""The coarse matrix on the CPU: summed by vector units, factored and solved in place.

The same as `coarse_modes.assemble`, `coarse_space.join_blocks` and an inverse; tests compare them.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ...core.awake import Awake
from ...core.particles import ByPart, Particles
from ...core.vector_units import OPTIONS, over_block
from ..pairs.rows import PairRows

wp.set_module_options(OPTIONS)


@wp.func_native(
    over_block(
        """
    const long long stride = matrix.strides[0] / sizeof(float);
    // A mode has six numbers; zero is added to the next two.
    auto add = [&](int own, int theirs, f8 r, f8 s) __attribute__((always_inline)) {
        float* entries = matrix.data + 6 * own * stride + 6 * theirs;
        for (int p = 0; p < 6; p++, entries += stride) store(entries, load(entries) + s[p] * r);
    };
""",
        """
    const int own = cell.data[i], acting = pairs.acting.data[i];
    const long long first = pairs.first.data[i];
    const int* other = pairs.other.data + first;
    const float* x = (const float*)position.data + 3 * (long long)i;
    const float* c = (const float*)center.data + 3 * (long long)own;
    const float ax = x[0] - c[0], ay = x[1] - c[1], az = x[2] - c[2];
    auto mode = [&](float nx, float ny, float nz) __attribute__((always_inline)) {
        return (f8){nx, ny, nz, ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx, 0.f, 0.f};
    };
    const float* b = (const float*)own_block.data + 9 * (long long)i;
    add(own, own, mode(b[0], b[3], b[6]), mode(1.f, 0.f, 0.f));
    add(own, own, mode(b[1], b[4], b[7]), mode(0.f, 1.f, 0.f));
    add(own, own, mode(b[2], b[5], b[8]), mode(0.f, 0.f, 1.f));
    for (int e = 0; e < acting; e++) {
        const int theirs = cell.data[other[e]];
        if (theirs == own) continue;
        const f8 r = mode(
            pairs.direction_x.data[first + e],
            pairs.direction_y.data[first + e],
            pairs.direction_z.data[first + e]
        );
        add(own, theirs < 0 ? own : theirs, r, r * pairs.stiffness.data[first + e]);
    }
""",
    )
)
def assemble_block(
    block: int,
    awake: Awake,
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    own_block: wp.array[wp.mat33],
    pairs: PairRows,
    matrix: wp.array2d[float],
) -> None: ...


@wp.kernel(enable_backward=False)
def assemble(
    awake: Awake,
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    own_block: wp.array[wp.mat33],
    pairs: PairRows,
    matrix: wp.array2d[float],
) -> None:
    """`coarse_modes.assemble`."""
    assemble_block(wp.tid(), awake, cell, center, position, own_block, pairs, matrix)


# Cholesky factorization. Cells are ordered by connected group, so a row begins no earlier than the
# first cell of its group; the entries before that are zero and skipped.
@wp.func_native("""{
    #pragma clang fp reassociate(on) contract(fast)
    const int n = size.data[0], cells = n / 6;
    const long long stride = matrix.strides[1] / sizeof(float);
    const long long pitch = factor.strides[0] / sizeof(double);
    double* L = factor.data;
    const int parts = matrix.shape[0];
    const long long next_part = matrix.strides[0] / sizeof(float);
    auto entry_of = [&](int row, int column) __attribute__((always_inline)) {
        double total = 0.0;
        for (int part = 0; part < parts; part++)
            total += matrix.data[part * next_part + row * stride + column];
        return total;
    };
    for (int a = 0; a < cells; a++) {
        int begin = 6 * a;
        for (int p = 0; p < 6; p++)
            for (int q = 0; q < 6; q++) {
                const double entry = entry_of(6 * a + p, 6 * a + q);
                const double turned = entry_of(6 * a + q, 6 * a + p);
                L[(6 * a + p) * pitch + 6 * a + q] = 0.5 * (entry + turned);
            }
        for (int b = 0; b < cells; b++) {
            if (b == a) continue;
            double trace = 0.0;
            for (int k = 0; k < 3; k++) trace += entry_of(6 * a + k, 6 * b + k);
            const bool joined = trace > 0.0;
            if (!joined && b > a) continue;
            if (joined && 6 * b < begin) begin = 6 * b;
            double d[3];
            for (int k = 0; k < 3; k++)
                d[k] = ((const float*)center.data)[3 * a + k]
                    - ((const float*)center.data)[3 * b + k];
            for (int p = 0; p < 6; p++) {
                double m[6];
                for (int q = 0; q < 6; q++) m[q] = entry_of(6 * a + p, 6 * b + q);
                double* row = L + (6 * a + p) * pitch;
                if (joined) for (int q = 0; q < 6; q++) row[6 * a + q] += m[q];
                if (b > a) continue;
                row[6 * b + 0] = -m[0];
                row[6 * b + 1] = -m[1];
                row[6 * b + 2] = -m[2];
                row[6 * b + 3] = -(m[3] + d[1] * m[2] - d[2] * m[1]);
                row[6 * b + 4] = -(m[4] + d[2] * m[0] - d[0] * m[2]);
                row[6 * b + 5] = -(m[5] + d[0] * m[1] - d[1] * m[0]);
            }
        }
        for (int p = 0; p < 6; p++) {
            const int i = 6 * a + p;
            double* row = L + i * pitch;
            row[i] += p < 3 ? shift_ridge[p] : turn_ridge[p - 3];
            for (int j = begin; j <= i; j++) {
                const double* pivot = L + j * pitch;
                int k = j < i && starts.data[j] > begin ? starts.data[j] : begin;
                double total = row[j];
                for (; k < j; k++) total -= row[k] * pivot[k];
                if (j < i) row[j] = total * inverses.data[j];
                else {
                    // A mode without any resistance does not move.
                    row[i] = total;
                    inverses.data[i] = total > 1e-30 ? 1.0 / __builtin_sqrt(total) : 0.0;
                }
            }
            starts.data[i] = begin;
        }
    }
}""")
def factor_matrix(
    size: wp.array[int],
    center: wp.array[wp.vec3],
    shift_ridge: wp.vec3,
    turn_ridge: wp.vec3,
    matrix: wp.array3d[float],
    factor: wp.array2d[wp.float64],
    inverses: wp.array[wp.float64],
    starts: wp.array[int],
) -> None: ...


@wp.kernel(enable_backward=False)
def factor(
    size: wp.array[int],
    center: wp.array[wp.vec3],
    shift_ridge: wp.vec3,
    turn_ridge: wp.vec3,
    matrix: wp.array3d[float],
    lower: wp.array2d[wp.float64],
    inverses: wp.array[wp.float64],
    starts: wp.array[int],
) -> None:
    """Factor the coarse matrix into a lower triangle and the inverses of its diagonal."""
    factor_matrix(size, center, shift_ridge, turn_ridge, matrix, lower, inverses, starts)


@wp.func_native("""{
    #pragma clang fp reassociate(on) contract(fast)
    const int n = size.data[0];
    const long long pitch = factor.strides[0] / sizeof(double);
    double* y = work.data;
    const long long next_part = sums.strides[0] / sizeof(double);
    auto sum_of = [&](int i) __attribute__((always_inline)) {
        double total = 0.0;
        for (int part = 0; part < sums.shape[0]; part++) total += sums.data[part * next_part + i];
        return total;
    };
    for (int i = 0; i < n; i++) {
        const double* row = factor.data + i * pitch;
        double total = sum_of(i);
        for (int k = starts.data[i]; k < i; k++) total -= row[k] * y[k];
        y[i] = total * inverses.data[i];
    }
    double all = 0.0;
    for (int i = n - 1; i >= 0; i--) {
        const double* row = factor.data + i * pitch;
        const double x = y[i] * inverses.data[i];
        for (int k = starts.data[i]; k < i; k++) y[k] -= row[k] * x;
        modes.data[i] = (float)x;
        all += x * sum_of(i);
    }
    energy.data[place] += all;
}""")
def solve_factored(
    size: wp.array[int],
    factor: wp.array2d[wp.float64],
    inverses: wp.array[wp.float64],
    starts: wp.array[int],
    work: wp.array[wp.float64],
    sums: wp.array2d[wp.float64],
    modes: wp.array[float],
    energy: wp.array[wp.float64],
    place: int,
) -> None: ...


@wp.kernel(enable_backward=False)
def solve(
    size: wp.array[int],
    lower: wp.array2d[wp.float64],
    inverses: wp.array[wp.float64],
    starts: wp.array[int],
    work: wp.array[wp.float64],
    sums: wp.array2d[wp.float64],
    modes: wp.array[float],
    energy: wp.array[wp.float64],
    place: int,
) -> None:
    """Solve for the motions of the cells with the factor."""
    solve_factored(size, lower, inverses, starts, work, sums, modes, energy, place)


class Factor:
    """The factored coarse matrix; each part of the particles factors and solves for itself.

    Args:
        size: Largest number of rows.
        particles: The particles in the cells.
    """

    def __init__(self, size: int, particles: Particles) -> None:
        self.particles = particles
        device, parts = particles.device, particles.parts
        self.lower = wp.zeros((parts, size, size), dtype=wp.float64, device=device)
        self.inverses = wp.zeros((parts, size), dtype=wp.float64, device=device)
        self.starts = wp.zeros((parts, size), dtype=int, device=device)
        self.work = wp.zeros((parts, size), dtype=wp.float64, device=device)

    def factorize(
        self, size: wp.array, center: wp.array, ridge: NDArray[np.float64], matrix: wp.array
    ) -> None:
        """Factor the sums of `assemble`; ``ridge`` is added to each cell's diagonal [kg, kg m²]."""
        self.particles.launch_once(
            factor,
            size,
            center,
            wp.vec3(*ridge[:3]),
            wp.vec3(*ridge[3:]),
            matrix,
            *(ByPart.rows(array) for array in (self.lower, self.inverses, self.starts)),
        )

    def solve(
        self, size: wp.array, sums: wp.array, modes: wp.array, energy: wp.array, place: int
    ) -> None:
        """Solve for the motions of the cells, and add their energy at ``place`` [J]."""
        own = (self.lower, self.inverses, self.starts, self.work)
        self.particles.launch_once(
            solve,
            size,
            *(ByPart.rows(array) for array in own),
            sums,
            ByPart.rows(modes),
            ByPart.rows(energy),
            place,
        )
