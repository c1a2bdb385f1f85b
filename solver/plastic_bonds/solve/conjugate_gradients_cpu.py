# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of conjugate gradients for the CPU, a block of particles at a time.

The kernels of the same names in `conjugate_gradients` are the same passes, for reading and for
GPUs; a test holds the two to the same results.
"""

import warp as wp

from ...core.awake import Awake
from ...core.vector_units import OPTIONS, over_block
from .data import Solve

wp.set_module_options(OPTIONS)

_CELLS = """
    const float* __restrict__ positions = (const float*)solve.position.data;
    const float* __restrict__ centers = (const float*)solve.center.data;
    float* __restrict__ residuals = (float*)solve.residual.data;
    float* __restrict__ preconditioned = (float*)solve.z.data;
    float* __restrict__ changes = (float*)solve.change.data;
    const int part = awake.part, parts = solve.size.shape[0];
    const long long pitch = solve.size.strides[0] / sizeof(double);
    const float* __restrict__ modes = solve.modes.data + part * solve.modes.shape[1];
    double* __restrict__ cell_sums = solve.sums.data + part * solve.sums.shape[1];
    auto over_parts = [&](const double* data, int iteration) {
        double total = 0.0;
        for (int k = 0; k < parts; k++) total += data[k * pitch + iteration];
        return total;
    };
    auto residual_size = [&](int iteration) {
        return over_parts(solve.size.data, iteration)
            + solve.coarse_size.data[part * pitch + iteration];
    };
    auto arm = [&](int i, int own) __attribute__((always_inline)) {
        return load3(positions + 3 * (long long)i) - load3(centers + 3 * own);
    };
    auto velocity_of_cell = [&](int i) __attribute__((always_inline)) {
        const int own = solve.cell.data[i];
        const float* m = modes + 6 * own;
        return load3(m) + cross(load3(m + 3), arm(i, own));
    };
"""

# Successive particles mostly share a cell, so its sums stay in registers until the cell changes, in
# single precision over the few particles of a block.
_PRECONDITION = """
    f4 sizes = (f4)(0.f), shift = (f4)(0.f), turn = (f4)(0.f);
    int current = -1;
    auto flush = [&]() __attribute__((always_inline)) {
        if (current < 0) return;
        double* own = cell_sums + 6 * current;
        for (int p = 0; p < 3; p++) {
            own[p] += shift[p];
            own[p + 3] += turn[p];
        }
        shift = turn = (f4)(0.f);
    };
    auto precondition = [&](int i, f4 r) __attribute__((always_inline)) {
        const float* inverse = (const float*)solve.inverse.data + 9 * (long long)i;
        const f4 z = load3(inverse) * r.x + load3(inverse + 3) * r.y + load3(inverse + 6) * r.z;
        store3(preconditioned + 3 * (long long)i, z);
        sizes += z * r;
        const int own = solve.cell.data[i];
        if (own != current) {
            flush();
            current = own;
        }
        shift += r;
        turn += cross(arm(i, own), r);
    };
    auto size_sum = [&]() { return (double)((sizes.x + sizes.y) + sizes.z); };
"""


@wp.func_native(
    over_block(
        _CELLS + _PRECONDITION,
        """
    const float* block = (const float*)diagonal.data + 9 * (long long)i;
    const float size = 1.f / (block[0] + block[4] + block[8]);
    float a[9];
    for (int k = 0; k < 9; k++) a[k] = block[k] * size;
    float* inverse = (float*)solve.inverse.data + 9 * (long long)i;
    const float c0 = a[4] * a[8] - a[5] * a[7];
    const float c1 = a[5] * a[6] - a[3] * a[8];
    const float c2 = a[3] * a[7] - a[4] * a[6];
    const float d = a[0] * c0 + a[1] * c1 + a[2] * c2;
    const float scale = d != 0.f ? size / d : 0.f;
    inverse[0] = c0 * scale;
    inverse[1] = (a[2] * a[7] - a[1] * a[8]) * scale;
    inverse[2] = (a[1] * a[5] - a[2] * a[4]) * scale;
    inverse[3] = c1 * scale;
    inverse[4] = (a[0] * a[8] - a[2] * a[6]) * scale;
    inverse[5] = (a[2] * a[3] - a[0] * a[5]) * scale;
    inverse[6] = c2 * scale;
    inverse[7] = (a[1] * a[6] - a[0] * a[7]) * scale;
    inverse[8] = (a[0] * a[4] - a[1] * a[3]) * scale;
    store3(changes + 3 * (long long)i, (f4)(0.f));
    precondition(i, load3(residuals + 3 * (long long)i));
""",
        """
    flush();
    solve.size.data[part * pitch] += size_sum();
""",
    )
)
def start_block(block: int, awake: Awake, diagonal: wp.array[wp.mat33], solve: Solve) -> None: ...


@wp.kernel(enable_backward=False)
def start(awake: Awake, diagonal: wp.array[wp.mat33], solve: Solve) -> None:
    """`conjugate_gradients.start`."""
    start_block(wp.tid(), awake, diagonal, solve)


@wp.func_native(
    over_block(
        _CELLS
        + """
    float ratio = 0.f;
    if (iteration > 0) {
        const double before = residual_size(iteration - 1), now = residual_size(iteration);
        if (before > 0.0) ratio = (float)(now / before);
    }
""",
        """
    f4* direction = (f4*)solve.direction.data + i;
    f4 next = load3(preconditioned + 3 * (long long)i) + *direction * ratio + velocity_of_cell(i);
    next.w = 0.f;
    *direction = next;
""",
    )
)
def turn_block(block: int, awake: Awake, iteration: int, solve: Solve) -> None: ...


@wp.kernel(enable_backward=False)
def turn(awake: Awake, iteration: int, solve: Solve) -> None:
    """`conjugate_gradients.turn`."""
    turn_block(wp.tid(), awake, iteration, solve)


@wp.func_native(
    over_block(
        _CELLS
        + _PRECONDITION
        + """
    float length = 0.f;
    const double curvature = over_parts(solve.curvature.data, iteration);
    if (curvature > 0.0) length = (float)(residual_size(iteration) / curvature);
""",
        """
    const f4 direction = ((const f4*)solve.direction.data)[i];
    float* change = changes + 3 * (long long)i;
    float* residual = residuals + 3 * (long long)i;
    store3(change, load3(change) + direction * length);
    const f4 product = load3((const float*)solve.product.data + 3 * (long long)i);
    const f4 r = load3(residual) - product * length;
    store3(residual, r);
    precondition(i, r);
""",
        """
    flush();
    solve.size.data[part * pitch + iteration + 1] += size_sum();
""",
    )
)
def advance_block(block: int, awake: Awake, iteration: int, solve: Solve) -> None: ...


@wp.kernel(enable_backward=False)
def advance(awake: Awake, iteration: int, solve: Solve) -> None:
    """`conjugate_gradients.advance`."""
    advance_block(wp.tid(), awake, iteration, solve)


@wp.func_native(
    over_block(
        _CELLS,
        """
    float* kept = changes + 3 * (long long)i;
    float* v = (float*)velocity.data + 3 * (long long)i;
    f4 change = load3(kept) + velocity_of_cell(i);
    const float all = change.x + change.y + change.z;
    if (!(__builtin_fabsf(all) < __builtin_inff())) change = (f4)(0.f);
    store3(kept, change);
    store3(v, load3(v) + change);
""",
    )
)
def finish_block(block: int, awake: Awake, solve: Solve, velocity: wp.array[wp.vec3]) -> None: ...


@wp.kernel(enable_backward=False)
def finish(awake: Awake, solve: Solve, velocity: wp.array[wp.vec3]) -> None:
    """`conjugate_gradients.finish`."""
    finish_block(wp.tid(), awake, solve, velocity)
