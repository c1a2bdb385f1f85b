# SPDX-License-Identifier: GPL-3.0-or-later
"""The sound field against closed forms and another package's value."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tactile_clay.haptics import TransducerArray, acoustic_field
from tactile_clay.haptics.acoustics.acoustic_field import _piston, propagation

ONE = TransducerArray.grid(1, 1, 0.01, p0=2.0, radius=0.0045, speed_of_sound=343.0)


def test_focus_on_the_axis_agrees_with_levitate():
    """Match levitate 3.0.0: 16 × 16, 10.5 mm, z = 0.2 m, p0 = 6, a = 4.5 mm: 6355.452 Pa."""
    # levitate's speed of sound is 343.23714360505863 m/s.
    array = TransducerArray.grid(
        16, 16, 0.0105, p0=6.0, radius=0.0045, speed_of_sound=343.23714360505863
    )
    point = np.array([(0.0, 0.0, 0.2)])
    drive = np.exp(-1j * np.angle(propagation(array, point)[0]))
    assert abs(acoustic_field(array, drive, point)[0]) == pytest.approx(6355.452, rel=1e-7)


def test_pressure_on_the_axis_falls_with_distance():
    """Give p0 / d and the phase k d in front of one transducer."""
    points = np.array([(0.0, 0.0, d) for d in (0.05, 0.1, 0.4)])
    found = acoustic_field(ONE, [1.0], points)
    d = points[:, 2]
    assert np.allclose(found, 2.0 / d * np.exp(1j * ONE.wavenumber * d))


def test_directivity_is_that_of_a_piston():
    """Match 2 J1(x) / x, computed by Bessel's integral, up to large pistons."""
    angle = (np.arange(20000) + 0.5) * (math.pi / 20000)
    for ka in (0.5, 3.3, 8.0, 12.0):
        sine = np.linspace(0.01, 1.0, 25)
        x = ka * sine
        bessel = np.cos(angle[:, None] - x * np.sin(angle[:, None])).mean(0)
        assert np.allclose(_piston(sine**2, ka), 2.0 * bessel / x, atol=2e-10)


def test_nothing_is_emitted_backward():
    """Produce no sound behind the baffle."""
    assert acoustic_field(ONE, [1.0], [(0.01, 0, -0.1)])[0] == 0.0


def test_a_point_source_emits_equally_in_all_directions():
    """Give the same pressure at the same distance everywhere in front."""
    source = replace(ONE, radius=0.0)
    points = [(0.1 * math.sin(a), 0.0, 0.1 * math.cos(a)) for a in (0.0, 0.7, 1.5)]
    assert np.allclose(np.abs(acoustic_field(source, [1.0], points)), 20.0)


def test_fields_add_up():
    """Be linear in the drive, and compute the same in chunks as at once."""
    array = TransducerArray.preset("openmpd")
    random = np.random.default_rng(0)
    first, second = np.exp(2j * np.pi * random.random((2, array.count)))
    points = random.uniform((-0.1, -0.1, 0.05), (0.1, 0.1, 0.3), (3000, 3))
    total = acoustic_field(array, first + 2j * second, points)
    added = acoustic_field(array, first, points) + 2j * acoustic_field(array, second, points)
    assert np.allclose(total, added)
    assert np.allclose(
        total[1500:1505], propagation(array, points[1500:1505]) @ (first + 2j * second)
    )


def test_phase_offsets_shift_the_emitted_phase():
    """Add each transducer's own phase to the phase of its drive."""
    late = replace(ONE, phase_offsets=np.array([0.7]))
    point = [(0.01, 0.02, 0.1)]
    ratio = acoustic_field(late, [1.0], point) / acoustic_field(ONE, [1.0], point)
    assert ratio[0] == pytest.approx(np.exp(0.7j))


def test_the_field_moves_with_the_array():
    """Give the same pressure when array and point move together."""
    array = TransducerArray.preset("ultraino")
    pose = np.array([[0, 0, 1, 0.3], [1, 0, 0, -0.2], [0, 1, 0, 0.5], [0, 0, 0, 1.0]])
    point = np.array([0.02, -0.01, 0.12])
    drive = np.exp(1j * np.arange(array.count))
    moved = pose[:3, :3] @ point + pose[:3, 3]
    here = acoustic_field(array, drive, [point])[0]
    assert acoustic_field(array.placed(pose), drive, [moved])[0] == pytest.approx(here)


def test_a_point_on_a_transducer_is_finite():
    """Stay finite where the far-field formula is not valid."""
    found = acoustic_field(ONE, [1.0], [(0, 0, 0), (0, 0, 1e-9)])
    assert np.isfinite(found).all()


def test_a_drive_of_the_wrong_size_is_refused():
    """Say how many values a drive needs."""
    with pytest.raises(ValueError, match=r"\(1,\)"):
        acoustic_field(ONE, [1.0, 1.0], [(0, 0, 0.1)])
