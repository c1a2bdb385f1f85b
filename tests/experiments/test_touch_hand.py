# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch of the solver's hand: the paper's figures 4 and 6 hold for it."""

from pathlib import Path

import pytest

from tactile_clay.tests.experiments.touch_hand import HandPress, draw_presses, press_hands


@pytest.fixture(scope="module")
def presses() -> list[HandPress]:
    """Presses into soft and stiffer clay, with coarse particles."""
    return press_hands(("wet_clay", "plasticine"), depth=0.008, spacing=0.01)


def test_contact_forces_are_those_on_the_hand(presses: list[HandPress]):
    """Sum the ghosts' forces to the hand's, over most of its palm side."""
    for press in presses:
        lifted = press.touch.contacts.forces[:, 2].sum()
        assert lifted == pytest.approx(press.force, rel=1e-3)
        assert press.touched_area > 50e-4


def test_more_plastic_clay_is_felt_as_softer(presses: list[HandPress], tmp_path: Path):
    """Feel less pressure from clay that yields sooner, under the same motion (figure 6)."""
    soft, stiff = presses
    assert soft.contact_pressure < 0.5 * stiff.contact_pressure
    pressures = [p.touch.weighted.foci.pressures.mean() for p in presses]
    assert pressures[0] < 0.6 * pressures[1]
    draw_presses(presses, tmp_path / "presses.png")
    assert (tmp_path / "presses.png").stat().st_size > 50_000


def test_weights_serve_finger_pads(presses: list[HandPress]):
    """Render the pads of a hand in clay better with weights (figure 4)."""
    touch = presses[1].touch
    assert touch.on_pads(touch.weighted).error < 0.95 * touch.on_pads(touch.even).error
