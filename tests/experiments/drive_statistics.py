# SPDX-License-Identifier: GPL-3.0-or-later
"""How accurately drives achieve the pressures of foci, over many random sets of foci."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactile_clay.haptics import TransducerArray, acoustic_field, solve_drive
from tactile_clay.haptics.acoustics.drive import METHODS
from tactile_clay.tests.haptics.target_sets import Targets, random_targets


@dataclass(frozen=True)
class DriveStatistics:
    """Ratio of achieved to wanted pressure, over all foci of all sets."""

    array: str
    """Description of the array."""
    method: str
    """Method of the drive solver."""
    mean: float
    """Mean ratio."""
    deviation: float
    """Standard deviation of the ratio over its mean in each set: how well proportions are kept."""
    uniformity: float
    """1 − (max − min) / (max + min) of a set, averaged over all sets (Di Leonardo 2007)."""
    weakest: float
    """First percentile of the ratio."""
    milliseconds: float
    """Median processor time of a solve [ms]."""
    ratios: NDArray[np.float64]
    """Ratio for every focus."""


def judge_drives(
    array: TransducerArray, name: str, method: str, targets: Sequence[Targets]
) -> DriveStatistics:
    """Solve all sets, and evaluate the field at their foci."""
    ratios, shapes, uniform, seconds = [], [], [], []
    for points, pressures in targets:
        begin = time.process_time()
        drive = solve_drive(array, points, pressures, method=method)
        seconds.append(time.process_time() - begin)
        ratio = np.abs(acoustic_field(array, drive, points)) / pressures
        ratios.append(ratio)
        shapes.append(ratio / ratio.mean())
        uniform.append(1.0 - np.ptp(ratio) / (ratio.max() + ratio.min()))
    found = np.concatenate(ratios)
    return DriveStatistics(
        array=name,
        method=method,
        mean=float(found.mean()),
        deviation=float(np.concatenate(shapes).std()),
        uniformity=float(np.mean(uniform)),
        weakest=float(np.percentile(found, 1)),
        milliseconds=1e3 * float(np.median(seconds)),
        ratios=found,
    )


def judge_methods(count: int = 1000) -> list[DriveStatistics]:
    """Judge all methods on an ideal array: 16 × 16, any phase and amplitude."""
    ideal = TransducerArray.preset("stratos_explore")
    targets = random_targets(count)
    return [judge_drives(ideal, "any phase, any amplitude", m, targets) for m in METHODS]


def judge_steps(count: int = 1000) -> list[DriveStatistics]:
    """Judge the loss from quantized phases and amplitudes on the same array."""
    ideal = TransducerArray.preset("stratos_explore")
    targets = random_targets(count)
    kinds = {
        "256 phases, 255 amplitudes": (256, 255),
        "128 phases, 64 amplitudes": (128, 64),
        "any phase, on or off": (None, 1),
        "32 phases, on or off": (32, 1),
        "16 phases, on or off": (16, 1),
        "10 phases, on or off": (10, 1),
    }
    return [
        judge_drives(
            replace(ideal, phase_steps=phases, amplitude_steps=amplitudes), name, "exact", targets
        )
        for name, (phases, amplitudes) in kinds.items()
    ]


def judge_presets(count: int = 1000) -> list[DriveStatistics]:
    """Judge every preset on sets of up to eight foci, at pressures that it can reach."""
    results = []
    for name in TransducerArray.preset_names():
        array = TransducerArray.preset(name)
        alone = solve_drive(array, [(0.0, 0.0, 0.2)], [1e9])
        reach = float(np.abs(acoustic_field(array, alone, [(0.0, 0.0, 0.2)]))[0])
        targets = random_targets(count, most=8, loudest=0.3 * reach)
        results.append(judge_drives(array, name, "exact", targets))
    return results
