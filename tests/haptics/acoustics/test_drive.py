# SPDX-License-Identifier: GPL-3.0-or-later
"""Drives: foci have their pressures, within what an array can emit."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_clay.haptics import TransducerArray, acoustic_field, drive_steps, solve_drive
from tactile_clay.haptics.acoustics.drive import METHODS
from tactile_clay.haptics.acoustics.drive_steps import realised
from tactile_clay.tests.haptics.target_sets import random_targets

ARRAY = TransducerArray.grid(16, 16, 0.0105, p0=3.4, radius=0.0045)
ON_OFF = replace(ARRAY, phase_steps=32, amplitude_steps=1)


def achieved(array, positions, pressures, method="exact"):
    """What foci get over what they should."""
    drive = solve_drive(array, positions, pressures, method=method)
    assert np.abs(drive).max() <= 1.0 + 1e-12
    return np.abs(acoustic_field(array, drive, positions)) / pressures


@pytest.mark.parametrize("method", METHODS)
def test_one_focus_gets_what_it_should(method):
    """Give a lone focus exactly its pressure, by every method."""
    ratio = achieved(ARRAY, np.array([(0.02, -0.01, 0.18)]), np.array([700.0]), method)
    assert ratio[0] == pytest.approx(1.0, abs=2e-3)


def test_foci_get_unequal_pressures():
    """Keep two to one as two to one."""
    points = np.array([(-0.03, 0, 0.2), (0.03, 0, 0.2), (0, 0.04, 0.2), (0, -0.04, 0.2)])
    assert np.allclose(achieved(ARRAY, points, np.array([800.0, 400, 400, 200])), 1.0, atol=2e-3)


def test_default_is_exact_on_random_targets():
    """Miss the targets of up to 32 unequal foci by less than 1 % (one standard deviation)."""
    ratios = np.concatenate([achieved(ARRAY, *targets) for targets in random_targets(40)])
    assert ratios.mean() == pytest.approx(1.0, abs=0.005)
    assert ratios.std() < 0.01


def test_methods_rank_as_published():
    """Spread less with GS-PAT than with the naive sum, and less with eigen/Tikhonov than either."""
    spread = {}
    for method in METHODS:
        ratios = [achieved(ARRAY, *t, method) for t in random_targets(30)]
        spread[method] = np.concatenate([r / r.mean() for r in ratios]).std()
    assert spread["eigen"] < 0.01 < spread["wgs"] < spread["gspat"] < spread["naive"]


def test_gspat_agrees_with_eigen():
    """Find, from GS-PAT's phases and from the eigenvector's, fields of the same pressures."""
    positions, pressures = random_targets(1, fewest=8, most=8)[0]
    first = acoustic_field(ARRAY, solve_drive(ARRAY, positions, pressures), positions)
    second = acoustic_field(
        ARRAY, solve_drive(ARRAY, positions, pressures, method="eigen"), positions
    )
    assert np.allclose(np.abs(first), np.abs(second), rtol=5e-3)


def test_too_much_is_scaled_down_alike():
    """Give all foci the same part of what they should have where the array is too weak."""
    points = np.array([(-0.03, 0, 0.2), (0.03, 0, 0.2), (0, 0.04, 0.2)])
    ratio = achieved(ARRAY, points, np.array([8000.0, 4000.0, 2000.0]))
    assert ratio.mean() < 0.5
    assert np.ptp(ratio) < 0.01 * ratio.mean()


def test_full_power_of_one_focus_is_all_transducers_in_step():
    """Reach the sum of what all transducers can give where more is asked."""
    point = np.array([(0.01, 0.0, 0.2)])
    drive = solve_drive(ARRAY, point, [1e6])
    assert np.allclose(np.abs(drive), 1.0)
    most = sum(
        abs(acoustic_field(ARRAY, np.eye(ARRAY.count)[i], point)[0]) for i in range(ARRAY.count)
    )
    assert abs(acoustic_field(ARRAY, drive, point)[0]) == pytest.approx(most)


def test_on_or_off_holds_only_what_the_board_has():
    """Use 32 phases and no amplitude between off and on."""
    drive = solve_drive(ON_OFF, *random_targets(1)[0])
    size = np.abs(drive)
    assert np.isclose(size, 0.0).sum() + np.isclose(size, 1.0).sum() == len(drive)
    on = drive[size > 0.5]
    steps = np.angle(on) / (2 * np.pi) * 32
    assert np.allclose(steps, np.rint(steps), atol=1e-9)


def test_on_or_off_dims_by_turning_transducers_off():
    """Meet targets within 5 % without amplitudes, with fewer transducers for less pressure."""
    counts = []
    for part in (1.0, 0.5):
        ratios = []
        for positions, pressures in random_targets(15, fewest=1, most=8):
            drive = solve_drive(ON_OFF, positions, part * pressures)
            counts.append((part, (np.abs(drive) > 0.5).sum()))
            ratios.append(np.abs(acoustic_field(ON_OFF, drive, positions)) / (part * pressures))
        found = np.concatenate(ratios)
        assert found.mean() == pytest.approx(1.0, abs=0.03)
        assert found.std() < 0.05
    full, half = (np.mean([c for p, c in counts if p == part]) for part in (1.0, 0.5))
    assert half < 0.7 * full


def test_phase_offsets_of_the_board_are_made_up_for():
    """Reach the same pressures with transducers that each add a phase of their own."""
    offsets = np.random.default_rng(1).uniform(-np.pi, np.pi, ARRAY.count)
    array = replace(ARRAY, phase_offsets=offsets)
    assert np.allclose(achieved(array, *random_targets(1, most=6)[0]), 1.0, atol=5e-3)


@pytest.mark.parametrize("pressures", [[], [0.0]])
def test_nothing_asked_is_silence(pressures):
    """Turn all transducers off without foci, or with foci of no pressure."""
    places = np.tile((0, 0, 0.2), (len(pressures), 1))
    assert (solve_drive(ARRAY, places, pressures) == 0.0).all()


def test_a_focus_behind_the_array_is_left_out():
    """Give the other focus its pressure where one cannot be reached at all."""
    points = np.array([(0, 0, -0.2), (0, 0, 0.2)])
    drive = solve_drive(ARRAY, points, [500.0, 500.0])
    assert abs(acoustic_field(ARRAY, drive, points[1:])[0]) == pytest.approx(500.0, rel=2e-3)


def test_two_foci_in_one_place_stay_finite():
    """Give a finite drive where two foci cannot be told apart."""
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
    """Say what is wrong with foci that do not fit or are not finite."""
    with pytest.raises(ValueError, match=r"expected|finite|method"):
        solve_drive(ARRAY, positions, pressures, method=method)


def test_steps_are_what_a_board_is_told():
    """Round to the nearest phase, around zero too, and to the nearest pulse width."""
    array = replace(TransducerArray.preset("openmpd"), phase_steps=8, amplitude_steps=4)
    drive = np.zeros(array.count, complex)
    drive[:4] = np.exp(1j * np.array([0.1, -0.1, np.pi / 4, -np.pi / 4]))
    drive[4] = np.sin(np.pi / 8)
    phases, amplitudes = drive_steps(array, drive)
    assert phases[:4].tolist() == [0, 0, 1, 7]
    assert amplitudes[:6].tolist() == [4, 4, 4, 4, 1, 0]
    again = realised(array, realised(array, drive))
    assert np.allclose(again, realised(array, drive))


def test_a_board_may_make_up_for_its_pulse_width():
    """Tell AUTD3 the amplitude itself, in 255 parts."""
    array = TransducerArray.preset("autd3")
    drive = np.zeros(array.count, complex)
    drive[:3] = (1.0, 0.503j, -0.2)
    phases, amplitudes = drive_steps(array, drive)
    assert phases[:3].tolist() == [0, 64, 128]
    assert amplitudes[:3].tolist() == [255, 128, 51]
    assert np.allclose(realised(array, drive), drive, atol=1 / 500)
