# SPDX-License-Identifier: GPL-3.0-or-later
"""Matrix products that run on the calling thread."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAX_VECTOR, _MAX_COMPLEX, _MAX_REAL = 4000, 60_000, 250_000
"""Measured numbers of multiplications up to which OpenBLAS uses a single thread, for the product of
a matrix and a vector, of two complex matrices and of two real ones."""


def small_product(first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    """Product of two matrices, or of a matrix and a vector, in blocks too small for more threads.

    The products of one frame are so small that threads gain nothing. When other work keeps the
    cores busy, though, a threaded product waits about 10 ms for a thread that is not scheduled.
    """
    limit = _MAX_COMPLEX if np.iscomplexobj(second) else _MAX_REAL
    if second.ndim == 1:
        limit = _MAX_VECTOR
    rows = max(1, limit // max(1, second.size))
    if rows >= len(first):
        return first @ second
    return np.concatenate(
        [first[begin : begin + rows] @ second for begin in range(0, len(first), rows)]
    )
