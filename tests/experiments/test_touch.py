# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch as a whole: the claims of the report hold."""

import math
from pathlib import Path

import numpy as np
import pytest

from tactile_clay.haptics import TransducerArray
from tactile_clay.solver import Material
from tactile_clay.tests.experiments import touch, touch_pictures, touch_report
from tactile_clay.tests.experiments.drive_statistics import judge_drives, judge_methods
from tactile_clay.tests.experiments.press import press
from tactile_clay.tests.haptics.target_sets import random_targets


@pytest.fixture(scope="module")
def hand() -> touch.Hand:
    """A coarse hand."""
    return touch.generated_hand(edge_length=0.0055)


def test_weights_serve_finger_pads(hand: touch.Hand, tmp_path: Path):
    """Render finger pads better with perceptual weights than without, and draw the result."""
    result = touch.compare_weights(hand)
    assert result.on_pads(result.weighted).error < 0.92 * result.on_pads(result.even).error
    touch_pictures.draw_weights(result, tmp_path / "weights.png")
    assert (tmp_path / "weights.png").stat().st_size > 20_000


def test_true_minimizer_reconstructs_better_than_the_printed_form(hand: touch.Hand):
    """Reproduce pressure better with Σ p* G / Σ G² on contacts of every size."""
    for result in touch.compare_rules(hand):
        assert result.true.error < 0.95 * result.printed.error
        assert result.gain > 1.3


def test_spatiotemporal_modulation_wins_on_large_contacts(hand: touch.Hand):
    """Halve the shape error on palm and hand, and cover them, in theory and in the sound field."""
    results = {r.contact: r for r in touch.compare_modulations(hand, samples=30)}
    for name in ("palm", "whole hand"):
        r = results[name]
        assert r.spatiotemporal.shape_error < 0.5 * r.amplitude.shape_error
        assert r.spatiotemporal.coverage > 0.95 > 0.7 > r.amplitude.coverage
        assert r.spatiotemporal_sound.shape_error < 0.75 * r.amplitude_sound.shape_error
    # The cost: each point is stimulated for only part of the time.
    assert results["whole hand"].spatiotemporal.gain > 2.0
    # There is no gain on one fingertip.
    one = results["one fingertip"]
    assert one.spatiotemporal.shape_error > 0.9 * one.amplitude.shape_error


def test_more_plastic_clay_is_felt_as_softer():
    """Yield lower focal pressures for clay that yields sooner under the same press."""
    pressures = []
    for stress in (1e3, 5e3):
        material = Material(yield_stress=stress, viscosity=20.0)
        force = press(0.006, radius=0.01, counts=(8, 8, 6), material=material).force_moving
        contacts = touch.ball_contacts(0.01, 0.006, force)
        result = touch.render_touch(contacts, touch.array_below())
        lifted = -(contacts.forces[:, 2]).sum()
        assert abs(lifted) == pytest.approx(force, rel=1e-6)
        pressures.append(result.foci.pressures.max())
    assert 50.0 < pressures[0] < 0.7 * pressures[1] < 700.0


def test_contact_of_a_ball_has_the_force_it_is_given():
    """Exert F over the projected area of the contact."""
    contacts = touch.ball_contacts(0.012, 0.012, 18.0)
    pressure = np.linalg.norm(contacts.forces, axis=1) / contacts.areas
    assert contacts.forces[:, 2].sum() == pytest.approx(18.0)
    assert pressure.max() == pytest.approx(18.0 / (math.pi * 0.012**2), rel=0.1)


def test_drives_are_judged_correctly():
    """Find the naive sum uneven, the default exact, and its mean as requested."""
    found = {r.method: r for r in judge_methods(20)}
    assert found["exact"].deviation < 0.005 < 0.2 < found["naive"].deviation
    assert found["exact"].uniformity > 0.99
    assert found["exact"].mean == pytest.approx(1.0, abs=0.01)
    too_loud = judge_drives(
        TransducerArray.preset("ultraino"), "", "exact", random_targets(3, most=2, loudest=1e5)
    )
    assert too_loud.mean < 0.1


def test_width_of_a_focus_grows_with_height():
    """Widen a focus with distance from the array, to about a wavelength at 30 cm."""
    array = TransducerArray.preset("stratos_explore")
    near, far = (touch_report.focus_width(array, height) for height in (0.1, 0.3))
    assert 0.35 < near / array.wavelength < 0.55
    assert 0.85 < far / array.wavelength < 1.15


def test_pictures_and_tables_are_written(tmp_path: Path):
    """Write the table and picture of drives, and the picture of materials."""
    lines = touch_report._drives(tmp_path, 3)
    assert sum(line.startswith(("| exact", "| 32 phases", "| autd3")) for line in lines) == 3
    clays = [
        touch.MaterialTouch("soft", 1e3, 3.0, 6e3, 270.0),
        touch.MaterialTouch("stiff", 25e3, 90.0, 200e3, 1000.0),
    ]
    touch_pictures.draw_materials(clays, tmp_path / "touch_materials.png")
    for name in ("touch_drives.png", "touch_materials.png"):
        assert (tmp_path / name).stat().st_size > 10_000


def test_modulations_are_drawn(hand: touch.Hand, tmp_path: Path):
    """Draw foci and routes over the hand."""
    results = touch.compare_modulations(hand, samples=2)
    touch_pictures.draw_modulations(results, hand, tmp_path / "modulations.png")
    assert (tmp_path / "modulations.png").stat().st_size > 50_000
