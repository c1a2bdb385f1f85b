# SPDX-License-Identifier: GPL-3.0-or-later
"""From contacts to focal points, frame by frame."""

import numpy as np
import pytest

import tactile_clay.haptics
from tactile_clay.haptics import TransducerArray
from tactile_clay.haptics.foci.pipeline import TouchPipeline
from tactile_clay.tests.bench.touch_latency import Contacts, palm_contacts

pytestmark = pytest.mark.skipif(
    not hasattr(tactile_clay.haptics, "PressureField"), reason="there is no pressure field yet"
)
ARRAY = TransducerArray.preset("sonicsurface")


def test_focal_points_follow_what_presses() -> None:
    """Follow three circling fingers without jumps."""
    pipeline = TouchPipeline()
    last = None
    for number in range(20):
        frame = pipeline.step([palm_contacts(number)], ARRAY, dt=1 / 60)
        assert 3 <= frame.foci.count <= 8
        assert frame.skin is not None
        assert frame.reconstructed is not None
        assert frame.wanted is not None
        assert len(frame.skin) == len(frame.reconstructed) == len(frame.wanted)
        if last is not None and last.foci.count == frame.foci.count:
            moved = np.linalg.norm(frame.foci.positions - last.foci.positions, axis=1)
            assert moved.max() < ARRAY.wavelength
        last = frame


def test_no_contact_and_no_hand_give_no_focal_points() -> None:
    """Give no focal points if no ghost carries a force, or if there is no hand."""
    still = palm_contacts(0)
    still = Contacts(still.positions, still.normals, still.areas, np.zeros_like(still.forces))
    assert TouchPipeline().step([still], ARRAY).foci.count == 0
    assert TouchPipeline().step([], ARRAY).foci.count == 0


def test_a_hand_that_is_bound_again_starts_anew() -> None:
    """Continue without an error when a hand has different ghosts than in the last frame."""
    pipeline = TouchPipeline()
    pipeline.step([palm_contacts(0)], ARRAY, dt=1 / 60)
    whole = palm_contacts(1)
    half = Contacts(*(getattr(whole, name)[::2] for name in Contacts.__dataclass_fields__))
    assert pipeline.step([half], ARRAY, dt=1 / 60).foci.count > 0
    both = pipeline.step([half, whole], ARRAY, dt=1 / 60)
    assert both.skin is not None
    assert len(both.skin) > len(half.areas)


def test_weights_draw_focal_points() -> None:
    """Ignore skin with a weight of 0."""
    contacts = palm_contacts(0)
    left = contacts.positions[:, 0] < 0.0
    frame = TouchPipeline().step([contacts], ARRAY, weights=[left.astype(float)], count=3)
    assert (frame.foci.positions[:, 0] < 0.01).all()


def test_options_out_of_range_are_refused() -> None:
    """Refuse a gain of 0, by name."""
    with pytest.raises(ValueError, match="gain"):
        TouchPipeline().step([palm_contacts(0)], ARRAY, gain=0.0)
