# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of conjugate gradients for the CPU, a block of particles at a time.

The kernels of `conjugate_gradients` with the same names are the same passes for reading and for
graphics cards; a test holds the two to the same results.
"""

import warp as wp

from .awake import Awake
from .solve_data import Solve
from .vector_units import OPTIONS, over_block

wp.set_module_options(OPTIONS)

_CELLS = """
    const float* __restrict__ positions = (const float*)solve.position.data;
    const float* __restrict__ centers = (const float*)solve.center.data;
    float* __restrict__ residuals = (float*)solve.residual.data;
    float* __restrict__ preconditioned = (float*)solve.z.data;
    float* __restrict__ directions = (float*)solve.direction.data;
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
    auto velocity_of_cell = [&](int i, float& x, float& y, float& z)
        __attribute__((always_inline)) {
        const int own = solve.cell.data[i];
        const float* c = centers + 3 * own;
        const float* m = modes + 6 * own;
        const float* at = positions + 3 * (long long)i;
        const float ax = at[0] - c[0], ay = at[1] - c[1], az = at[2] - c[2];
        x += m[0] + m[4] * az - m[5] * ay;
        y += m[1] + m[5] * ax - m[3] * az;
        z += m[2] + m[3] * ay - m[4] * ax;
    };
"""

# Neighbours mostly share a cell: its sums are kept at hand until another comes.
_PRECONDITION = """
    double size_sum = 0.0;
    double sums[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    int at_hand = -1;
    auto put_down = [&]() __attribute__((always_inline)) {
        if (at_hand < 0) return;
        for (int p = 0; p < 6; p++) {
            cell_sums[6 * at_hand + p] += sums[p];
            sums[p] = 0.0;
        }
    };
    auto precondition = [&](int i, float x, float y, float z) __attribute__((always_inline)) {
        const float* inverse = (const float*)solve.inverse.data + 9 * (long long)i;
        const float zx = inverse[0] * x + inverse[1] * y + inverse[2] * z;
        const float zy = inverse[3] * x + inverse[4] * y + inverse[5] * z;
        const float zz = inverse[6] * x + inverse[7] * y + inverse[8] * z;
        float* kept = preconditioned + 3 * (long long)i;
        kept[0] = zx;
        kept[1] = zy;
        kept[2] = zz;
        size_sum += zx * x + zy * y + zz * z;
        const int own = solve.cell.data[i];
        if (own != at_hand) {
            put_down();
            at_hand = own;
        }
        const float* c = centers + 3 * own;
        const float* at = positions + 3 * (long long)i;
        const float ax = at[0] - c[0], ay = at[1] - c[1], az = at[2] - c[2];
        sums[0] += x;
        sums[1] += y;
        sums[2] += z;
        sums[3] += ay * z - az * y;
        sums[4] += az * x - ax * z;
        sums[5] += ax * y - ay * x;
    };
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
    float* change = changes + 3 * (long long)i;
    change[0] = change[1] = change[2] = 0.f;
    const float* r = residuals + 3 * (long long)i;
    precondition(i, r[0], r[1], r[2]);
""",
        """
    put_down();
    solve.size.data[part * pitch] += size_sum;
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
    const float* z = preconditioned + 3 * (long long)i;
    float* direction = directions + 4 * (long long)i;
    float x = z[0] + direction[0] * ratio;
    float y = z[1] + direction[1] * ratio;
    float w = z[2] + direction[2] * ratio;
    velocity_of_cell(i, x, y, w);
    direction[0] = x;
    direction[1] = y;
    direction[2] = w;
    direction[3] = 0.f;
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
    const float* direction = directions + 4 * (long long)i;
    const float* product = (const float*)solve.product.data + 3 * (long long)i;
    float* change = changes + 3 * (long long)i;
    float* r = residuals + 3 * (long long)i;
    for (int k = 0; k < 3; k++) {
        change[k] += direction[k] * length;
        r[k] -= product[k] * length;
    }
    precondition(i, r[0], r[1], r[2]);
""",
        """
    put_down();
    solve.size.data[part * pitch + iteration + 1] += size_sum;
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
    float* change = changes + 3 * (long long)i;
    float* v = (float*)velocity.data + 3 * (long long)i;
    velocity_of_cell(i, change[0], change[1], change[2]);
    const float all = change[0] + change[1] + change[2];
    if (!(__builtin_fabsf(all) < __builtin_inff())) change[0] = change[1] = change[2] = 0.f;
    v[0] += change[0];
    v[1] += change[1];
    v[2] += change[2];
""",
    )
)
def finish_block(block: int, awake: Awake, solve: Solve, velocity: wp.array[wp.vec3]) -> None: ...


@wp.kernel(enable_backward=False)
def finish(awake: Awake, solve: Solve, velocity: wp.array[wp.vec3]) -> None:
    """`conjugate_gradients.finish`."""
    finish_block(wp.tid(), awake, solve, velocity)
