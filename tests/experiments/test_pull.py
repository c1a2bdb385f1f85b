# SPDX-License-Identifier: GPL-3.0-or-later
"""A bar pulled at both ends necks and breaks in two."""

import numpy as np
import pytest

from tactile_clay.tests.experiments.pieces import pieces
from tactile_clay.tests.experiments.pull import Pull, pull
from tactile_clay.tests.experiments.shapes import block


def test_pieces_are_separated_by_gaps():
    """Find two blocks and a crumb, and one piece if the reach spans the gap."""
    one, two = block(3, 1.0), block(2, 1.0, (6.0, 0, 0))
    points = np.concatenate([two, [(0.0, 20.0, 0.0)], one])
    assert [len(piece) for piece in pieces(points, 1.0)] == [27, 8, 1]
    assert set(pieces(points, 1.0)[1]) == set(range(8))
    assert [len(piece) for piece in pieces(points, 1.0, reach=5.0)] == [35, 1]


def test_no_particles_form_no_pieces():
    """Return no pieces for no particles."""
    assert pieces(np.zeros((0, 3)), 1.0) == []


@pytest.fixture(scope="module")
def pulled() -> Pull:
    """A pulled bar, shared by the tests."""
    return pull()


def test_bar_draws_out_half_its_length_before_it_breaks(pulled: Pull):
    """Stretch the free length, twice the thickness, beyond 1.5 times."""
    assert pulled.stretch > 1.5


def test_bar_necks_before_it_breaks(pulled: Pull):
    """Thin to less than a quarter of the cross-section."""
    assert pulled.neck < 0.25


def test_bar_breaks_into_two_clean_pieces(pulled: Pull):
    """Leave two pieces, and at most eight particles outside them."""
    assert pulled.piece_count == 2
    assert pulled.debris <= 8
    assert pulled.evenness > 0.2


def test_bar_is_as_strong_as_a_plastic_bar(pulled: Pull):
    """Resist with √3 τ_y A to two fifths."""
    assert pulled.force_ratio == pytest.approx(1.0, abs=0.4)
