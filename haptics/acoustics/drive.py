# SPDX-License-Identifier: GPL-3.0-or-later
"""From focal points to what each transducer emits: several foci at once, of given pressures.

Of a sound field only the pressure's magnitude at the foci is asked for; their phases are free. All
methods here choose these phases, and differ in how.

- Naive: every focus by itself, added up.
- GS-PAT: Plasencia, Hirayama, Montano-Murillo, Subramanian, "GS-PAT: High-Speed Multi-Point Sound-
  Fields for Phased Arrays of Transducers", ACM Trans. Graph. 39(4), 2020 (10.1145/3386569.3392492).
- Eigen: Long, Seah, Carter, Subramanian, "Rendering Volumetric Haptic Shapes in Mid-Air using
  Ultrasound", ACM Trans. Graph. 33(6), 2014 (10.1145/2661229.2661257).
- Weighted Gerchberg–Saxton: Di Leonardo, Ianni, Ruocco, Opt. Express 15(4), 2007
  (10.1364/OE.15.001913), whose holograms of traps are the same problem.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .acoustic_field import propagation
from .drive_steps import realised
from .small_product import small_product
from .transducer_array import TransducerArray

METHODS = ("exact", "gspat", "wgs", "eigen", "naive")
"""What `solve_drive` can do; the first is the default."""

_REGULARISATION = 1e-3
"""Tikhonov's λ over the mean power that a focus gets from all transducers."""
_PHASE_SWEEPS = 10
_WEIGHT_SWEEPS = 5
_NEWTON_STEPS = 3
_NEWTON_STEPS_ON_OFF = 6
_SLACK = 1.1
"""Transducers left on over those that would just do: at their limit phases can balance nothing."""
_FEWEST = 3
"""Transducers that are left on for each focus, however faint: phases then make foci fainter."""

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def solve_drive(
    array: TransducerArray, positions: ArrayLike, pressures: ArrayLike, *, method: str = "exact"
) -> Complex:
    """Find a drive that gives foci their pressures, within what the array can emit.

    Where the array is too weak, all foci get the same part of their pressure. An array with
    amplitude steps emits less by driving transducers less; one whose transducers are only on or
    off, by turning an evenly spread part of them off. The result holds only phases and amplitudes
    that the array has.

    ``"exact"`` takes its phases from GS-PAT and the drive of least power that has these pressures
    and phases at the foci (Tikhonov, as Long et al.). Where this asks more of some transducer than
    it has, or amplitudes cannot be set, it goes on with all transducers alike: weighted
    Gerchberg–Saxton, then Gauss–Newton steps of the phases.

    Args:
        array: The array, placed in the world.
        positions: Foci in world coordinates [m], shape [K, 3].
        pressures: Peak pressure wanted at each of them [Pa], shape [K]; foci of none are left out.
        method: One of `METHODS`.

    Returns:
        Amplitude (0 to 1) and phase of each transducer, shape [T]; zeros where nothing is asked.

    Raises:
        ValueError: Shapes do not fit, a value is not finite or a pressure below 0, or there is no
            such method.
    """
    if method not in METHODS:
        raise ValueError(f"There is no method {method!r}. There are: {', '.join(METHODS)}.")
    places = np.asarray(positions, np.float64)
    wanted = np.asarray(pressures, np.float64)
    if wanted.ndim != 1 or places.shape != (len(wanted), 3):
        raise ValueError(
            f"Foci have positions of shape {places.shape} and pressures of shape {wanted.shape}; "
            "expected (K, 3) and (K,)."
        )
    if not (np.isfinite(places).all() and np.isfinite(wanted).all() and (wanted >= 0).all()):
        raise ValueError("Positions and pressures of foci must be finite, pressures at least 0.")
    transfer = propagation(array, places[wanted > 0.0])
    target = wanted[wanted > 0.0]
    heard = np.abs(transfer).max(axis=1, initial=0.0) > 0.0
    transfer, target = transfer[heard], target[heard]
    if len(target) == 0:
        return np.zeros(array.count, np.complex128)
    if array.amplitude_steps == 1:
        return _on_or_off(array, transfer, target, method)
    return realised(array, _graded(transfer, target, method))


def _graded(transfer: Complex, target: Real, method: str) -> Complex:
    """Drive of transducers that can be set to any amplitude up to 1, shape [T]."""
    drive = _start(transfer, target, method)
    largest = float(np.abs(drive).max())
    if method == "exact" and largest > 1.0:
        drive = _newton(transfer, target, _weighted(transfer, target, drive), None)
    if method != "exact" or largest > 1.0:
        drive = drive / _gain(small_product(transfer, drive), target)
    return drive / max(float(np.abs(drive).max()), 1.0)


def _on_or_off(array: TransducerArray, transfer: Complex, target: Real, method: str) -> Complex:
    """Drive of transducers that emit fully or not at all, shape [T]."""
    on = np.ones(array.count, bool)
    phases, gain = _all_alike(transfer, target, method)
    part = max(_SLACK / gain, _FEWEST * len(target) / array.count)
    if part < 1.0:
        order = _scatter(array)
        on = order <= np.quantile(order, part)
        phases, gain = _all_alike(transfer[:, on], target, method)
    if method == "exact":
        wanted = min(1.0, gain / _SLACK)
        phases = _newton(transfer[:, on], target, phases, wanted, steps=_NEWTON_STEPS_ON_OFF)
    drive = np.zeros(array.count, np.complex128)
    drive[on] = phases
    return realised(array, drive)


def _all_alike(transfer: Complex, target: Real, method: str) -> tuple[Complex, float]:
    """Drive of amplitude 1, shape [T], and by how much it is stronger than the target."""
    drive = _unit(_start(transfer, target, method))
    if method == "exact":
        drive = _weighted(transfer, target, drive)
    return drive, _gain(small_product(transfer, drive), target)


def _start(transfer: Complex, target: Real, method: str) -> Complex:
    """Drive by one method, of any amplitude, shape [T]."""
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
    lifted = overlap + _REGULARISATION * power.mean() * np.eye(len(target))
    return small_product(adjoint, np.linalg.solve(lifted, focus))


def _alternate(overlap: Complex, target: Real, *, sweeps: int) -> Complex:
    """Phases that foci lend each other, with the target's amplitudes imposed, shape [K]."""
    focus = target.astype(np.complex128)
    for _ in range(sweeps):
        reached = overlap @ focus
        focus = reached * (target / np.maximum(np.abs(reached), 1e-30))
    return np.asarray(focus)


def _weighted(
    transfer: Complex, target: Real, drive: Complex, *, sweeps: int = _WEIGHT_SWEEPS
) -> Complex:
    """Drive of amplitude 1 whose foci have the target's proportions, by Di Leonardo's weights."""
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
    """Turn phases by Gauss–Newton until foci have `gain` times their target, or one common gain.

    There are more transducers than foci, so each step takes the least turn that would do.
    """
    for _ in range(steps):
        reached = small_product(transfer, drive)
        size = np.maximum(np.abs(reached), 1e-30)
        miss = (_gain(reached, target) if gain is None else gain) * target - size
        slope = -((reached.conj() / size)[:, None] * transfer * drive).imag
        normal = small_product(slope, slope.T)
        normal += 1e-3 * np.trace(normal) / len(target) * np.eye(len(target))
        turn = small_product(slope.T, np.linalg.solve(normal, miss))
        drive = drive * np.exp(1j * np.clip(turn, -0.7, 0.7))
    return drive


def _gain(reached: Complex, target: Real) -> float:
    """The factor by which the pressures reached fit the target best."""
    return max(float(np.abs(reached) @ target) / float(target @ target), 1e-30)


def _unit(values: Complex) -> Complex:
    size = np.abs(values)
    return np.where(size > 0.0, values / np.where(size > 0.0, size, 1.0), 1.0)


def _scatter(array: TransducerArray) -> Real:
    """A number in 0 to 1 for each transducer, so that those below any limit lie evenly, shape [T].

    The two-dimensional low-discrepancy sequence of the plastic number (Roberts 2018), by place.
    """
    inverse = np.linalg.inv(array.pose)
    own = array.positions @ inverse[:2, :3].T + inverse[:2, 3]
    apart = np.linalg.norm(own[1:] - own[0], axis=1)
    pitch = float(apart[apart > 1e-6].min(initial=1.0))
    return np.asarray((np.rint(own / pitch * 2.0) * 0.5) @ (0.7548776662, 0.5698402910) % 1.0)
