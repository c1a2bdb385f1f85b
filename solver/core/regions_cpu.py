# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring regions on the CPU: the pass of `regions`, a block of particles at a time."""

import warp as wp

from .awake import Awake
from .vector_units import OPTIONS, over_block

wp.set_module_options(OPTIONS)


@wp.func_native(
    over_block(
        "const long long stride = measures.strides[0] / sizeof(float);",
        """
    const float* x = (const float*)position.data + 3 * (long long)i;
    const float* v = (const float*)velocity.data + 3 * (long long)i;
    float* maxima = measures.data + stride * region.data[i];
    const float found[7] = {
        x[0], x[1], x[2], -x[0], -x[1], -x[2], v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    };
    for (int k = 0; k < 7; k++) maxima[k] = found[k] > maxima[k] ? found[k] : maxima[k];
""",
    )
)
def measure_block(
    block: int,
    awake: Awake,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    region: wp.array[int],
    measures: wp.array2d[float],
) -> None: ...


@wp.kernel(enable_backward=False)
def measure_regions(
    awake: Awake,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    region: wp.array[int],
    measures: wp.array2d[float],
) -> None:
    """`regions.measure_regions`."""
    measure_block(wp.tid(), awake, position, velocity, region, measures)
