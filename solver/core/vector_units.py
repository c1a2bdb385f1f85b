# SPDX-License-Identifier: GPL-3.0-or-later
"""C++ shared by the passes for the CPU's vector units, which process eight numbers at a time.

Clang's vector types compile to whatever the processor has (AVX, NEON). A pass works on a block of
particles at a time, because calling a kernel for each particle costs as much as the work itself.
"""

OPTIONS = {"cpu_compiler_flags": "-O3 -march=native"}
"""Module options that let the compiler use all instructions of this processor."""
BLOCK = 64
"""Particles in a block."""

NUMBERS = """
    #if defined(__CUDACC__)
    #define ALWAYS_INLINE
    auto maximum = [](float a, float b) { return fmaxf(a, b); };
    auto minimum = [](float a, float b) { return fminf(a, b); };
    auto root = [](float a) { return sqrtf(a); };
    auto power = [](float a, float b) { return powf(a, b); };
    #else
    #define ALWAYS_INLINE __attribute__((always_inline))
    auto maximum = [](auto a, auto b) ALWAYS_INLINE {
        return __builtin_elementwise_max(a, (decltype(a))b);
    };
    auto minimum = [](auto a, auto b) ALWAYS_INLINE {
        return __builtin_elementwise_min(a, (decltype(a))b);
    };
    auto root = [](auto a) ALWAYS_INLINE { return __builtin_elementwise_sqrt(a); };
    auto power = [](float a, float b) ALWAYS_INLINE { return __builtin_powf(a, b); };
    #endif
    auto select = [](auto mask, auto a, auto b) ALWAYS_INLINE { return mask ? a : (decltype(a))b; };
"""
"""Functions for formulas that are written once for floats and for lanes: a number is a float or, on
the CPU, also eight lanes of floats; a mask is a bool or eight lanes of -1 and 0."""

VECTORS = (
    f"""{{
    #pragma clang fp reassociate(on) contract(fast)
    {NUMBERS}"""
    + """
    typedef float f2 __attribute__((ext_vector_type(2)));
    typedef float f4 __attribute__((ext_vector_type(4)));
    typedef float f8 __attribute__((ext_vector_type(8)));
    typedef int i8 __attribute__((ext_vector_type(8)));
    typedef f2 f2u __attribute__((aligned(4)));
    typedef f4 f4u __attribute__((aligned(4)));
    typedef f8 f8u __attribute__((aligned(4)));
    const f8 zero = (f8)(0.f);
    const i8 lanes = {0, 1, 2, 3, 4, 5, 6, 7};
    auto load = [](const float* p) __attribute__((always_inline)) { return *(const f8u*)p; };
    auto store = [](float* p, f8 v) __attribute__((always_inline)) { *(f8u*)p = v; };
    auto sum = [](f8 a) __attribute__((always_inline)) {
        const f4 b = a.lo + a.hi;
        return (b.x + b.z) + (b.y + b.w);
    };
    // A vector of three numbers, read as four: the array must have room for one more at its end.
    auto load3 = [](const float* p) __attribute__((always_inline)) {
        f4 v = *(const f4u*)p;
        v.w = 0.f;
        return v;
    };
    auto store3 = [](float* p, f4 v) __attribute__((always_inline)) {
        *(f2u*)p = v.xy;
        p[2] = v.z;
    };
    auto cross = [](f4 a, f4 b) __attribute__((always_inline)) {
        return a.yzxw * b.zxyw - a.zxyw * b.yzxw;
    };
    // Four consecutive numbers of each of eight rows: loaded whole, then transposed.
    auto pick_rows = [](const float* p, const int* j, int pitch, f8& x, f8& y, f8& z, f8& w)
        __attribute__((always_inline)) {
        auto row = [&](int l) __attribute__((always_inline)) {
            return (f4)*(const f4u*)(p + pitch * (long long)j[l]);
        };
        const f8 ae = __builtin_shufflevector(row(0), row(4), 0, 1, 2, 3, 4, 5, 6, 7);
        const f8 bf = __builtin_shufflevector(row(1), row(5), 0, 1, 2, 3, 4, 5, 6, 7);
        const f8 cg = __builtin_shufflevector(row(2), row(6), 0, 1, 2, 3, 4, 5, 6, 7);
        const f8 dh = __builtin_shufflevector(row(3), row(7), 0, 1, 2, 3, 4, 5, 6, 7);
        const f8 ab = __builtin_shufflevector(ae, bf, 0, 8, 1, 9, 4, 12, 5, 13);
        const f8 cd = __builtin_shufflevector(cg, dh, 0, 8, 1, 9, 4, 12, 5, 13);
        const f8 ab2 = __builtin_shufflevector(ae, bf, 2, 10, 3, 11, 6, 14, 7, 15);
        const f8 cd2 = __builtin_shufflevector(cg, dh, 2, 10, 3, 11, 6, 14, 7, 15);
        x = __builtin_shufflevector(ab, cd, 0, 1, 8, 9, 4, 5, 12, 13);
        y = __builtin_shufflevector(ab, cd, 2, 3, 10, 11, 6, 7, 14, 15);
        z = __builtin_shufflevector(ab2, cd2, 0, 1, 8, 9, 4, 5, 12, 13);
        w = __builtin_shufflevector(ab2, cd2, 2, 3, 10, 11, 6, 7, 14, 15);
    };
    // Eight vectors of three or four numbers, by axis; for three, the array must have room for one
    // more number at its end.
    auto pick3 = [&](const float* p, const int* j, f8& x, f8& y, f8& z)
        __attribute__((always_inline)) {
        f8 next;
        pick_rows(p, j, 3, x, y, z, next);
    };
    auto pick4 = [&](const float* p, const int* j, f8& x, f8& y, f8& z, f8& w)
        __attribute__((always_inline)) {
        pick_rows(p, j, 4, x, y, z, w);
    };
"""
)


def over_block(setup: str, body: str, result: str = "") -> str:
    """Source of a native function that works on a block of particles.

    Args:
        setup: Statements before the loop over particles.
        body: Statements for each particle ``i``.
        result: Statements after the loop.

    Returns:
        The source; the function must have the arguments ``block`` and ``awake``.
    """
    return f"""{VECTORS}
    const int awake_count = awake.count.data[0], begin = block * {BLOCK};
    const int stop = begin + {BLOCK} < awake_count ? begin + {BLOCK} : awake_count;
    {setup}
    for (int thread = begin; thread < stop; thread++) {{
        const int i = awake.index.data[thread];
        {body}
    }}
    {result}
}}"""


def for_one(setup: str, body: str, result: str = "") -> str:
    """Source of a native function that does the same for a single particle ``i``."""
    return f"{VECTORS}{setup}{body}{result}}}"
