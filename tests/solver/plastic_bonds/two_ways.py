# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparing a pass for the CPU's vector units with its plain kernel."""

from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from tactile_clay.solver.plastic_bonds.model import PlasticBonds


def compare(
    model: PlasticBonds,
    plain: Callable[[], None],
    by_block: Callable[[], None],
    state: list[wp.array],
    results: dict[str, Callable[[], NDArray]],
    tolerance: float = 1e-5,
    allow_zero: bool = False,
) -> None:
    """Run both passes from the same state, and compare their results.

    Args:
        model: The model whose state is used.
        plain: Runs the plain pass.
        by_block: Runs the pass for the CPU's vector units.
        state: Arrays that the passes change, restored before each.
        results: Functions that read the results, by name.
        tolerance: Largest difference, relative to the largest value.
        allow_zero: Whether a result may be zero everywhere.
    """
    before = [array.numpy().copy() for array in state]
    outcomes = []
    for run in (plain, by_block):
        for array, values in zip(state, before, strict=True):
            array.assign(values)
        run()
        outcomes.append({name: result().copy() for name, result in results.items()})
    for array, values in zip(state, before, strict=True):
        array.assign(values)
    for name in results:
        one, two = (np.asarray(outcome[name], float) for outcome in outcomes)
        scale = np.abs(one).max()
        assert allow_zero or scale > 0, name
        np.testing.assert_allclose(two, one, rtol=0, atol=tolerance * scale, err_msg=name)


def acting(model: PlasticBonds, name: str) -> Callable[[], NDArray]:
    """Read the values of the acting slots of all rows, sorted by pair."""
    rows = model.pairs.rows

    def read() -> NDArray:
        first, count = rows.first.numpy(), rows.acting.numpy()
        slots = np.concatenate([np.arange(f, f + c) for f, c in zip(first, count, strict=True)])
        row = np.repeat(np.arange(len(first)), count)
        order = np.lexsort((rows.other.numpy()[slots], row))
        return getattr(rows, name).numpy()[slots][order]

    return read


def per_particle(*arrays: wp.array) -> dict[str, Callable[[], NDArray]]:
    """Read whole arrays."""
    return {str(number): array.numpy for number, array in enumerate(arrays)}


def over_parts(*arrays: wp.array) -> dict[str, Callable[[], NDArray]]:
    """Read sums over all parts of the particles."""

    def reader(array: wp.array) -> Callable[[], NDArray]:
        return lambda: array.numpy().sum(0)

    return {f"sum {number}": reader(array) for number, array in enumerate(arrays)}


def conditions(model: PlasticBonds) -> dict[str, Callable[[], NDArray]]:
    """Read each component of the particles' conditions separately."""

    def reader(place: int) -> Callable[[], NDArray]:
        return lambda: model.pairs.rows.condition.numpy()[:, place]

    return {f"condition {place}": reader(place) for place in range(4)}
