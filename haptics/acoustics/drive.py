# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds what each transducer must emit to produce several foci of given pressures at once.

Only the magnitude of the pressure at the foci is prescribed; their phases are free. The methods
differ in how they choose these phases.

- Naive: a drive for each focus by itself, summed.
- GS-PAT: Plasencia, Hirayama, Montano-Murillo, Subramanian, "GS-PAT: High-Speed Multi-Point Sound-
  Fields for Phased Arrays of Transducers", ACM Trans. Graph. 39(4), 2020 (10.1145/3386569.3392492).
- Eigen: Long, Seah, Carter, Subramanian, "Rendering Volumetric Haptic Shapes in Mid-Air using
  Ultrasound", ACM Trans. Graph. 33(6), 2014 (10.1145/2661229.2661257).
- Weighted Gerchberg–Saxton: Di Leonardo, Ianni, Ruocco, Opt. Express 15(4), 2007
  (10.1364/OE.15.001913); they compute holograms for optical traps, which is the same problem.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .acoustic_field import propagation
from .drive_steps import quantized
from .small_product import small_product
from .transducer_array import TransducerArray

METHODS = ("exact", "gspat", "wgs", "eigen", "naive")
"""Methods of `solve_drive`; the first is the default."""

_REGULARIZATION = 1e-3
"""Tikhonov's λ, relative to the mean power that a focus gets from all transducers."""
_PHASE_SWEEPS = 10
_WEIGHT_SWEEPS = 5
_NEWTON_STEPS = 3
_NEWTON_STEPS_ON_OFF = 6
_SLACK = 1.1
"""Transducers left on, relative to the minimum: with no reserve, phases cannot balance the foci."""
_MIN_PER_FOCUS = 3
"""Minimum number of transducers left on per focus; fainter foci are reached by phases alone."""

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def solve_drive(
    array: TransducerArray, positions: ArrayLike, pressures: ArrayLike, *, method: str = "exact"
) -> Complex:
    """Find a drive that produces foci of given pressures, within what the array can emit.

    If the array is too weak, all foci get the same fraction of their pressure. To emit less, an
    array with adjustable amplitudes lowers them; one whose transducers are only on or off turns an
    evenly spread part of them off. The result contains only phases and amplitudes that the array
    can produce.

    ``"exact"`` takes the phases from GS-PAT and finds the drive of least power with these pressures
    and phases at the foci (Tikhonov, as in Long et al.). If that would exceed the amplitude of some
    transducer, or if amplitudes cannot be adjusted, it continues with the same amplitude for all
    transducers: weighted Gerchberg–Saxton, then Gauss–Newton steps on the phases.

    Args:
        array: The array, placed in the world.
        positions: Foci in world coordinates [m], shape [K, 3].
        pressures: Target peak pressure at each [Pa], shape [K]; foci with 0 Pa are left out.
        method: One of `METHODS`.

    Returns:
        Amplitude (0 to 1) and phase of each transducer, shape [T]; zeros if there are no foci.

    Raises:
        ValueError: Shapes do not match, a value is not finite, a pressure is negative or the
            method is unknown.
    """
    if method not in METHODS:
        raise ValueError(f"There is no method {method!r}. There are: {', '.join(METHODS)}.")
    points = np.asarray(positions, np.float64)
    target = np.asarray(pressures, np.float64)
    if target.ndim != 1 or points.shape != (len(target), 3):
        raise ValueError(
            f"Foci have positions of shape {points.shape} and pressures of shape {target.shape}; "
            "expected (K, 3) and (K,)."
        )
    if not (np.isfinite(points).all() and np.isfinite(target).all() and (target >= 0).all()):
        raise ValueError("Positions and pressures of foci must be finite, pressures at least 0.")
    transfer = propagation(array, points[target > 0.0])
    target = target[target > 0.0]
    reachable = np.abs(transfer).max(axis=1, initial=0.0) > 0.0
    transfer, target = transfer[reachable], target[reachable]
    if len(target) == 0:
        return np.zeros(array.count, np.complex128)
    if array.amplitude_steps == 1:
        return _on_or_off(array, transfer, target, method)
    return quantized(array, _any_amplitude(transfer, target, method))


def _any_amplitude(transfer: Complex, target: Real, method: str) -> Complex:
    """Drive for transducers that can be set to any amplitude up to 1, shape [T]."""
    drive = _start(transfer, target, method)
    largest = float(np.abs(drive).max())
    if method == "exact" and largest > 1.0:
        drive = _newton(transfer, target, _weighted(transfer, target, drive), None)
    if method != "exact" or largest > 1.0:
        drive = drive / _gain(small_product(transfer, drive), target)
    return drive / max(float(np.abs(drive).max()), 1.0)


def _on_or_off(array: TransducerArray, transfer: Complex, target: Real, method: str) -> Complex:
    """Drive for transducers that are either fully on or off, shape [T]."""
    on = np.ones(array.count, bool)
    phases, gain = _full_amplitude(transfer, target, method)
    fraction = max(_SLACK / gain, _MIN_PER_FOCUS * len(target) / array.count)
    if fraction < 1.0:
        order = _scatter(array)
        on = order <= np.quantile(order, fraction)
        phases, gain = _full_amplitude(transfer[:, on], target, method)
    if method == "exact":
        wanted = min(1.0, gain / _SLACK)
        phases = _newton(transfer[:, on], target, phases, wanted, steps=_NEWTON_STEPS_ON_OFF)
    drive = np.zeros(array.count, np.complex128)
    drive[on] = phases
    return quantized(array, drive)


def _full_amplitude(transfer: Complex, target: Real, method: str) -> tuple[Complex, float]:
    """Drive with amplitude 1 everywhere, shape [T], and its pressures relative to the target."""
    drive = _unit(_start(transfer, target, method))
    if method == "exact":
        drive = _weighted(transfer, target, drive)
    return drive, _gain(small_product(transfer, drive), target)


def _start(transfer: Complex, target: Real, method: str) -> Complex:
    """First drive by one of the methods, with unlimited amplitudes, shape [T]."""
    adjoint = transfer.conj().T
    if method == "wgs":
        return _weighted(transfer, target, small_product(adjoint, target), sweeps=30)
    if method == "naive":
        return small_product(adjoint, target / (np.abs(transfer) ** 2).sum(1))
    overlap = small_product(transfer, adjoint)
    power = overlap.diagonal().real
    if method == "gspat":
        size = np.sqrt(power)
        overlap = overlap / np.outer(size, size)
        focus = _alternate(overlap, target, sweeps=100)
        reached = overlap @ focus
        focus = target * target / np.maximum(np.abs(reached), 1e-30) * _unit(reached)
        return small_product(adjoint, focus / size)
    if method == "eigen":
        size = np.sqrt(power)
        weighted = np.outer(target / size, target / size) * overlap
        focus = target * _unit(np.linalg.eigh(weighted)[1][:, -1])
    else:
        focus = _alternate(overlap, target, sweeps=_PHASE_SWEEPS)
    regularized = overlap + _REGULARIZATION * power.mean() * np.eye(len(target))
    return small_product(adjoint, np.linalg.solve(regularized, focus))


def _alternate(overlap: Complex, target: Real, *, sweeps: int) -> Complex:
    """Foci with the target amplitudes, phases found by alternating projections, shape [K]."""
    focus = target.astype(np.complex128)
    for _ in range(sweeps):
        reached = overlap @ focus
        focus = reached * (target / np.maximum(np.abs(reached), 1e-30))
    return np.asarray(focus)


def _weighted(
    transfer: Complex, target: Real, drive: Complex, *, sweeps: int = _WEIGHT_SWEEPS
) -> Complex:
    """Drive of amplitude 1 with foci in the target's proportions, by Di Leonardo's weights."""
    adjoint = transfer.conj().T
    weight = target.copy()
    drive = _unit(drive)
    for _ in range(sweeps):
        reached = small_product(transfer, drive)
        size = np.maximum(np.abs(reached), 1e-30)
        ratio = target / size
        weight *= ratio / ratio.mean()
        drive = _unit(small_product(adjoint, reached * (weight / size)))
    return drive


def _newton(
    transfer: Complex,
    target: Real,
    drive: Complex,
    gain: float | None,
    *,
    steps: int = _NEWTON_STEPS,
) -> Complex:
    """Adjust phases by Gauss–Newton until all foci have `gain` times their target pressure.

    With `gain` None, any gain common to all foci will do. There are more transducers than foci, so
    each step takes the least-norm change of the phases.
    """
    for _ in range(steps):
        reached = small_product(transfer, drive)
        size = np.maximum(np.abs(reached), 1e-30)
        residual = (_gain(reached, target) if gain is None else gain) * target - size
        jacobian = -((reached.conj() / size)[:, None] * transfer * drive).imag
        normal = small_product(jacobian, jacobian.T)
        normal += 1e-3 * np.trace(normal) / len(target) * np.eye(len(target))
        turn = small_product(jacobian.T, np.linalg.solve(normal, residual))
        drive = drive * np.exp(1j * np.clip(turn, -0.7, 0.7))
    return drive


def _gain(reached: Complex, target: Real) -> float:
    """Least-squares ratio of the pressures reached to the target."""
    return max(float(np.abs(reached) @ target) / float(target @ target), 1e-30)


def _unit(values: Complex) -> Complex:
    size = np.abs(values)
    return np.where(size > 0.0, values / np.where(size > 0.0, size, 1.0), 1.0)


def _scatter(array: TransducerArray) -> Real:
    """A number from 0 to 1 for each transducer; those below any limit are evenly spread, shape [T].

    The two-dimensional low-discrepancy sequence of the plastic number (Roberts 2018) over the grid.
    """
    inverse = np.linalg.inv(array.pose)
    local = array.positions @ inverse[:2, :3].T + inverse[:2, 3]
    distance = np.linalg.norm(local[1:] - local[0], axis=1)
    pitch = float(distance[distance > 1e-6].min(initial=1.0))
    return np.asarray((np.rint(local / pitch * 2.0) * 0.5) @ (0.7548776662, 0.5698402910) % 1.0)
