# SPDX-License-Identifier: GPL-3.0-or-later
"""Drives give foci their target pressures within what an array can emit."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_clay.haptics import TransducerArray, acoustic_field, drive_steps, solve_drive
from tactile_clay.haptics.acoustics.drive import METHODS
from tactile_clay.haptics.acoustics.drive_steps import quantized
from tactile_clay.tests.haptics.target_sets import random_targets

ARRAY = TransducerArray.grid(16, 16, 0.0105, p0=3.4, radius=0.0045)
ON_OFF = replace(ARRAY, phase_steps=32, amplitude_steps=1)


def achieved(array, positions, pressures, method="exact"):
    """Pressure at the foci relative to the target."""
    drive = solve_drive(array, positions, pressures, method=method)
    assert np.abs(drive).max() <= 1.0 + 1e-12
    return np.abs(acoustic_field(array, drive, positions)) / pressures


@pytest.mark.parametrize("method", METHODS)
def test_one_focus_gets_its_pressure(method):
    """Give a single focus its exact pressure with every method."""
    ratio = achieved(ARRAY, np.array([(0.02, -0.01, 0.18)]), np.array([700.0]), method)
    assert ratio[0] == pytest.approx(1.0, abs=2e-3)


def test_foci_get_unequal_pressures():
    """Keep the ratios between foci."""
    points = np.array([(-0.03, 0, 0.2), (0.03, 0, 0.2), (0, 0.04, 0.2), (0, -0.04, 0.2)])
    assert np.allclose(achieved(ARRAY, points, np.array([800.0, 400, 400, 200])), 1.0, atol=2e-3)


def test_default_is_exact_on_random_targets():
    """Miss the targets of up to 32 unequal foci by less than 1 % (one standard deviation)."""
    ratios = np.concatenate([achieved(ARRAY, *targets) for targets in random_targets(40)])
    assert ratios.mean() == pytest.approx(1.0, abs=0.005)
    assert ratios.std() < 0.01


def test_methods_rank_as_published():
    """Scatter less with GS-PAT than with the naive sum, and less with eigen/Tikhonov than both."""
    spread = {}
    for method in METHODS:
        ratios = [achieved(ARRAY, *t, method) for t in random_targets(30)]
        spread[method] = np.concatenate([r / r.mean() for r in ratios]).std()
    assert spread["eigen"] < 0.01 < spread["wgs"] < spread["gspat"] < spread["naive"]


def test_gspat_agrees_with_eigen():
    """Find fields with the same pressures from GS-PAT's phases and from the eigenvector's."""
    positions, pressures = random_targets(1, fewest=8, most=8)[0]
    first = acoustic_field(ARRAY, solve_drive(ARRAY, positions, pressures), positions)
    second = acoustic_field(
        ARRAY, solve_drive(ARRAY, positions, pressures, method="eigen"), positions
    )
    assert np.allclose(np.abs(first), np.abs(second), rtol=5e-3)


def test_excessive_pressures_are_scaled_down_equally():
    """Give all foci the same fraction of their pressure if the array is too weak."""
    points = np.array([(-0.03, 0, 0.2), (0.03, 0, 0.2), (0, 0.04, 0.2)])
    ratio = achieved(ARRAY, points, np.array([8000.0, 4000.0, 2000.0]))
    assert ratio.mean() < 0.5
    assert np.ptp(ratio) < 0.01 * ratio.mean()


def test_full_power_of_one_focus_is_all_transducers_in_phase():
    """Reach the sum of all transducers' pressures when more than that is requested."""
    point = np.array([(0.01, 0.0, 0.2)])
    drive = solve_drive(ARRAY, point, [1e6])
    assert np.allclose(np.abs(drive), 1.0)
    highest = sum(
        abs(acoustic_field(ARRAY, np.eye(ARRAY.count)[i], point)[0]) for i in range(ARRAY.count)
    )
    assert abs(acoustic_field(ARRAY, drive, point)[0]) == pytest.approx(highest)


def test_on_or_off_uses_only_what_the_board_supports():
    """Use 32 phases and no amplitude between off and on."""
    drive = solve_drive(ON_OFF, *random_targets(1)[0])
    size = np.abs(drive)
    assert np.isclose(size, 0.0).sum() + np.isclose(size, 1.0).sum() == len(drive)
    on = drive[size > 0.5]
    steps = np.angle(on) / (2 * np.pi) * 32
    assert np.allclose(steps, np.rint(steps), atol=1e-9)


def test_on_or_off_dims_by_turning_transducers_off():
    """Reach targets within 5 % with on and off alone, using fewer transducers for less pressure."""
    counts = []
    for scale in (1.0, 0.5):
        ratios = []
        for positions, pressures in random_targets(15, fewest=1, most=8):
            drive = solve_drive(ON_OFF, positions, scale * pressures)
            counts.append((scale, (np.abs(drive) > 0.5).sum()))
            ratios.append(np.abs(acoustic_field(ON_OFF, drive, positions)) / (scale * pressures))
        found = np.concatenate(ratios)
        assert found.mean() == pytest.approx(1.0, abs=0.03)
        assert found.std() < 0.05
    full, half = (np.mean([c for s, c in counts if s == scale]) for scale in (1.0, 0.5))
    assert half < 0.7 * full


def test_phase_offsets_of_the_board_are_compensated():
    """Reach the same pressures with transducers that each add their own phase."""
    offsets = np.random.default_rng(1).uniform(-np.pi, np.pi, ARRAY.count)
    array = replace(ARRAY, phase_offsets=offsets)
    assert np.allclose(achieved(array, *random_targets(1, most=6)[0]), 1.0, atol=5e-3)


@pytest.mark.parametrize("pressures", [[], [0.0]])
def test_no_foci_are_silence(pressures):
    """Turn all transducers off if there are no foci, or only foci with 0 Pa."""
    positions = np.tile((0, 0, 0.2), (len(pressures), 1))
    assert (solve_drive(ARRAY, positions, pressures) == 0.0).all()


def test_a_focus_behind_the_array_is_left_out():
    """Give the other focus its pressure if one cannot be reached."""
    points = np.array([(0, 0, -0.2), (0, 0, 0.2)])
    drive = solve_drive(ARRAY, points, [500.0, 500.0])
    assert abs(acoustic_field(ARRAY, drive, points[1:])[0]) == pytest.approx(500.0, rel=2e-3)


def test_two_foci_in_one_place_stay_finite():
    """Give a finite drive for two foci at the same point."""
    drive = solve_drive(ARRAY, [(0, 0, 0.2), (0, 0, 0.2)], [500.0, 100.0])
    assert np.isfinite(drive).all()
    assert np.abs(drive).max() <= 1.0 + 1e-12


@pytest.mark.parametrize(
    ("positions", "pressures", "method"),
    [
        ([(0, 0, 0.2)], [1.0, 2.0], "exact"),
        ([(0, np.nan, 0.2)], [1.0], "exact"),
        ([(0, 0, 0.2)], [-1.0], "exact"),
        ([(0, 0, 0.2)], [1.0], "best"),
    ],
)
def test_bad_foci_are_refused(positions, pressures, method):
    """Say what is wrong with foci that are not finite or whose shapes do not match."""
    with pytest.raises(ValueError, match=r"expected|finite|method"):
        solve_drive(ARRAY, positions, pressures, method=method)


def test_steps_are_the_nearest_of_the_board():
    """Round to the nearest phase, also around zero, and to the nearest pulse width."""
    array = replace(TransducerArray.preset("openmpd"), phase_steps=8, amplitude_steps=4)
    drive = np.zeros(array.count, complex)
    drive[:4] = np.exp(1j * np.array([0.1, -0.1, np.pi / 4, -np.pi / 4]))
    drive[4] = np.sin(np.pi / 8)
    phases, amplitudes = drive_steps(array, drive)
    assert phases[:4].tolist() == [0, 0, 1, 7]
    assert amplitudes[:6].tolist() == [4, 4, 4, 4, 1, 0]
    again = quantized(array, quantized(array, drive))
    assert np.allclose(again, quantized(array, drive))


def test_a_board_may_compensate_its_pulse_width():
    """Send AUTD3 the amplitude itself, in 255 steps."""
    array = TransducerArray.preset("autd3")
    drive = np.zeros(array.count, complex)
    drive[:3] = (1.0, 0.503j, -0.2)
    phases, amplitudes = drive_steps(array, drive)
    assert phases[:3].tolist() == [0, 64, 128]
    assert amplitudes[:3].tolist() == [255, 128, 51]
    assert np.allclose(quantized(array, drive), drive, atol=1 / 500)
