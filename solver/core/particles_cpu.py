# SPDX-License-Identifier: GPL-3.0-or-later
"""How particles fall and move, for the CPU: the passes of `particles`, a block at a time."""

import warp as wp

from .awake import Awake
from .vector_units import OPTIONS, over_block

wp.set_module_options(OPTIONS)


@wp.func_native(
    over_block(
        """
    const float* v = (const float*)velocity.data;
    float* free = (float*)velocity_free.data;
    int bad = 0;
""",
        """
    const long long k = 3 * (long long)i;
    float* now = (float*)v + k;
    // A sum with a part that is not finite is not finite either.
    if (!(__builtin_fabsf(now[0] + now[1] + now[2]) < __builtin_inff())) {
        now[0] = now[1] = now[2] = 0.f;
        bad++;
    }
    free[k] = now[0] + kick[0];
    free[k + 1] = now[1] + kick[1];
    free[k + 2] = now[2] + kick[2];
""",
        "quarantined.data[0] += bad;",
    )
)
def fall_block(
    block: int,
    awake: Awake,
    kick: wp.vec3,
    velocity: wp.array[wp.vec3],
    velocity_free: wp.array[wp.vec3],
    quarantined: wp.array[int],
) -> None: ...


@wp.kernel(enable_backward=False)
def fall_freely(
    awake: Awake,
    kick: wp.vec3,
    velocity: wp.array[wp.vec3],
    velocity_free: wp.array[wp.vec3],
    quarantined: wp.array[int],
) -> None:
    """`particles.fall_freely`."""
    fall_block(wp.tid(), awake, kick, velocity, velocity_free, quarantined)


@wp.func_native(
    over_block(
        """
    const float limit = speed_limit.data[0];
    int fast = 0, bad = 0;
""",
        """
    float* v = (float*)velocity.data + 3 * (long long)i;
    float* x = (float*)position.data + 3 * (long long)i;
    const float square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    if (square > limit * limit) {
        const float scale = limit / __builtin_sqrtf(square);
        for (int k = 0; k < 3; k++) v[k] *= scale;
        fast++;
    }
    const float a = x[0] + v[0] * time_step, b = x[1] + v[1] * time_step;
    const float c = x[2] + v[2] * time_step;
    if (__builtin_fabsf(a + b + c) < __builtin_inff()) {
        x[0] = a;
        x[1] = b;
        x[2] = c;
    } else {
        v[0] = v[1] = v[2] = 0.f;
        bad++;
    }
""",
        """
    clamped.data[0] += fast;
    quarantined.data[0] += bad;
""",
    )
)
def move_block(
    block: int,
    awake: Awake,
    time_step: float,
    velocity: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    speed_limit: wp.array[float],
    clamped: wp.array[int],
    quarantined: wp.array[int],
) -> None: ...


@wp.kernel(enable_backward=False)
def move(
    awake: Awake,
    time_step: float,
    velocity: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    speed_limit: wp.array[float],
    clamped: wp.array[int],
    quarantined: wp.array[int],
) -> None:
    """`particles.move`."""
    move_block(wp.tid(), awake, time_step, velocity, position, speed_limit, clamped, quarantined)


# Threads spin for a moment, then yield the processor: the thread they wait for may be waiting for
# it.
@wp.func_native("""{
#if defined(__linux__) || defined(__APPLE__)
    int yield_processor(void) __asm__("sched_yield");
#else
    auto yield_processor = []() {};
#endif
    int* arrived = counter.data;
    int* round = counter.data + 32;
    const int now = __atomic_load_n(round, __ATOMIC_ACQUIRE);
    if (__atomic_add_fetch(arrived, 1, __ATOMIC_ACQ_REL) == parts) {
        __atomic_store_n(arrived, 0, __ATOMIC_RELAXED);
        __atomic_store_n(round, now + 1, __ATOMIC_RELEASE);
        return;
    }
    for (int turn = 0; __atomic_load_n(round, __ATOMIC_ACQUIRE) == now; turn++) {
#if defined(__x86_64__)
        __builtin_ia32_pause();
#endif
        if (turn > 1000) yield_processor();
    }
}""")
def wait(counter: wp.array[int], parts: int) -> None: ...


@wp.kernel(enable_backward=False)
def wait_for_others(counter: wp.array[int], parts: int) -> None:
    """Wait until the threads of all parts have arrived."""
    wait(counter, parts)
