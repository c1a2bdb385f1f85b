# SPDX-License-Identifier: GPL-3.0-or-later
"""Matrix products that stay on the thread that asks for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAX_VECTOR, _MAX_COMPLEX, _MAX_REAL = 4000, 60_000, 250_000
"""Multiplications up to which OpenBLAS does a product of a matrix and a vector, of complex matrices
and of real ones on one thread, as measured."""


def small_product(first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    """The product of two matrices, or of a matrix and a vector, in pieces that one thread does.

    The products of a frame are so small that threads gain nothing; but where other work keeps the
    cores busy, a product waits some 10 ms for a thread that is not running.
    """
    matrix = _MAX_COMPLEX if np.iscomplexobj(second) else _MAX_REAL
    most = _MAX_VECTOR if second.ndim == 1 else matrix
    rows = max(1, most // max(1, second.size))
    if rows >= len(first):
        return first @ second
    return np.concatenate(
        [first[begin : begin + rows] @ second for begin in range(0, len(first), rows)]
    )
