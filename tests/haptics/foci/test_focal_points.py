# SPDX-License-Identifier: GPL-3.0-or-later
"""Focal points: correct positions and pressures, without flicker."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.haptics import focus, reconstruct

SIGMA = 0.00865
SPACING = 0.002


def skin(size: float = 0.08) -> np.ndarray:
    """A flat piece of skin 15 cm above the array."""
    axis = np.arange(-size / 2, size / 2 + 1e-9, SPACING)
    return np.stack(np.meshgrid(axis, axis, [0.15], indexing="ij"), -1).reshape(-1, 3)


def blob(points, x, y, radius, peak=500.0):
    """A round load around a point [Pa]."""
    square = (points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2
    return np.where(square < radius**2, peak * (1.0 - square / radius**2), 0.0)


def ones(points):
    """Uniform weights."""
    return np.ones(len(points))


def test_two_blobs_get_a_focus_each_at_their_weighted_centers():
    """Put foci at the centers of mass of α p*, and assign each blob's points to its own focus."""
    points = skin()
    pressures = blob(points, -0.021, 0.003, 0.007) + blob(points, 0.018, -0.01, 0.006, 300.0)
    weights = 1.0 + 20.0 * (points[:, 0] + 0.04)
    foci = focus(points, pressures, weights, sigma=SIGMA)
    assert foci.count == 2
    left = points[:, 0] < 0
    for side in (left, ~left):
        mass = (weights * pressures)[side]
        center = mass @ points[side] / mass.sum()
        assert np.linalg.norm(foci.positions - center, axis=1).min() < 0.15e-3
    nearest = np.argmin(np.abs(points[:, 0] + 0.021) + np.abs(points[:, 1] - 0.003))
    assert foci.positions[foci.assignment[nearest], 0] < 0


def test_pressures_are_the_minimizer_of_equation_nine():
    """Make the derivative of the squared error by the pressure of each focus zero."""
    points = skin()
    pressures = blob(points, 0, 0, 0.03) + blob(points, 0.01, 0.02, 0.01)
    foci = focus(points, pressures, ones(points), sigma=SIGMA, count=6)
    square = np.square(points - foci.positions[foci.assignment]).sum(1)
    gaussian = np.exp(-0.5 * square / SIGMA**2)
    error = reconstruct(foci, points) - pressures
    for index in range(foci.count):
        own = foci.assignment == index
        derivative = (gaussian * error)[own].sum()
        assert abs(derivative) < 1e-4 * (gaussian * pressures)[own].sum()


def test_printed_form_gives_less_and_fits_worse():
    """Reconstruct worse with the paper's Σ G in the denominator than with Σ G²."""
    points = skin()
    pressures = blob(points, 0, 0, 0.03)
    true, printed = (
        focus(points, pressures, ones(points), sigma=SIGMA, rule=rule)
        for rule in ("least_squares", "printed")
    )
    assert np.allclose(true.positions, printed.positions)
    assert (printed.pressures < true.pressures).all()
    errors = [np.linalg.norm(reconstruct(f, points) - pressures) for f in (true, printed)]
    assert errors[0] < 0.8 * errors[1]


def test_reconstruction_is_a_gaussian_in_its_own_region():
    """Fall to e^{-1/2} at one sigma, and switch foci halfway between them."""
    points = skin()
    foci = focus(
        points,
        blob(points, -0.02, 0, 0.005) + blob(points, 0.02, 0, 0.005),
        ones(points),
        sigma=SIGMA,
    )
    place = foci.positions[0]
    outward = np.array((np.sign(place[0]), 0, 0))
    found = reconstruct(foci, [place, place + SIGMA * outward, place * (0, 1, 1) - 1e-6 * outward])
    assert found[:2] == pytest.approx(foci.pressures[0] * np.array((1.0, np.exp(-0.5))))
    other = foci.pressures[1] * np.exp(-0.5 * (foci.positions[1, 0] / SIGMA) ** 2)
    assert found[2] == pytest.approx(other, rel=1e-2)


def test_as_many_foci_as_the_touched_skin_needs():
    """Use one focus for a fingertip, all for a palm, and never more than allowed."""
    points = skin()
    counts = [
        focus(points, blob(points, 0, 0, radius), ones(points), sigma=SIGMA, count=8).count
        for radius in (0.004, 0.008, 0.016, 0.04)
    ]
    assert counts[0] == counts[1] == 1
    assert 1 < counts[2] <= 8
    assert counts[3] == 8
    few = focus(points, blob(points, 0, 0, 0.04), ones(points), sigma=SIGMA, count=3)
    assert few.count == 3
    gone = focus(points, 0.0 * points[:, 0], ones(points), sigma=SIGMA, previous=few)
    assert gone.count == 0
    assert (gone.assignment == -1).all()
    assert (reconstruct(gone, points) == 0.0).all()


def test_foci_are_far_enough_apart_for_the_array_to_resolve():
    """Keep foci about one sigma apart or more."""
    points = skin()
    random = np.random.default_rng(0)
    for _ in range(10):
        x, y, radius = random.uniform((-0.02, -0.02, 0.005), (0.02, 0.02, 0.04))
        places = focus(points, blob(points, x, y, radius), ones(points), sigma=SIGMA).positions
        distance = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(len(places))
        assert distance.min() > 0.9 * SIGMA


def test_weights_draw_foci_to_sensitive_skin():
    """Fit the sensitive half better with weights than without."""
    points = skin()
    pressures = blob(points, 0, 0, 0.05)
    weights = np.where(points[:, 0] > 0.01, 1.0, 0.1)
    sensitive = weights == 1.0
    errors = []
    for alpha in (weights, ones(points)):
        foci = focus(points, pressures, alpha, sigma=SIGMA, count=5)
        errors.append(np.linalg.norm((reconstruct(foci, points) - pressures)[sensitive]))
    assert errors[0] < 0.9 * errors[1]


def test_foci_lie_on_curved_skin():
    """Put foci on the surface of a finger, not inside it."""
    angle, along = np.meshgrid(np.linspace(0, np.pi, 24), np.arange(0, 0.05, SPACING))
    radius = 0.008
    finger = np.stack([radius * np.cos(angle), along, radius * np.sin(angle)], -1).reshape(-1, 3)
    foci = focus(finger, np.full(len(finger), 300.0), ones(finger), sigma=SIGMA)
    depth = radius - np.hypot(foci.positions[:, 0], foci.positions[:, 2])
    assert foci.count >= 2
    assert np.abs(depth).max() < 0.6e-3


@pytest.mark.parametrize("gap", [0.008, 0.016])
def test_a_cluster_across_two_fingers_is_moved_onto_one(gap):
    """Put a focus for two fingers on one of them, not in the air between them or on an edge."""
    points = np.concatenate(
        [skin(0.012) + np.array((x, 0, 0)) for x in (-0.5 * gap - 0.006, 0.5 * gap + 0.006)]
    )
    foci = focus(points, np.full(len(points), 200.0), ones(points), sigma=SIGMA, count=1)
    assert np.linalg.norm(points - foci.positions[0], axis=1).min() < 0.75 * SPACING
    assert abs(foci.positions[0, 0]) > 0.5 * gap + 0.002


@pytest.mark.parametrize("radius", [0.006, 0.02, 0.035])
def test_foci_follow_a_moving_load_without_flicker(radius):
    """Move no focus much farther per frame than the load, and keep the order of foci."""
    points = skin(0.1)
    previous = None
    travels, changes = [], 0
    for frame in range(60):
        angle = frame * 2 * np.pi / 75
        pressures = blob(points, 0.015 * np.cos(angle), 0.015 * np.sin(angle), radius)
        foci = focus(points, pressures, ones(points), sigma=SIGMA, previous=previous)
        if previous is not None:
            if previous.count == foci.count:
                moved = np.linalg.norm(foci.positions - previous.positions, axis=1)
                travels.append(moved.max())
            else:
                changes += 1
        previous = foci
    load = 0.015 * 2 * np.pi / 75
    assert changes <= 4
    assert np.median(travels) < 2.0 * load
    assert np.percentile(travels, 95) < 4.0 * load


def test_a_still_load_has_still_foci():
    """Settle within a few frames under a constant load."""
    points = skin()
    random = np.random.default_rng(5)
    pressures = blob(points, 0.005, 0.0, 0.035) * random.uniform(0.7, 1.3, len(points))
    foci = focus(points, pressures, ones(points), sigma=SIGMA)
    for _ in range(15):
        foci = focus(points, pressures, ones(points), sigma=SIGMA, previous=foci)
    after = focus(points, pressures, ones(points), sigma=SIGMA, previous=foci)
    assert np.abs(after.positions - foci.positions).max() < 0.2e-3


def test_the_focus_of_a_lifted_finger_goes_to_another():
    """Drop the focus of skin that is no longer touched, and put one on newly touched skin."""
    points = skin()
    first = blob(points, -0.02, 0, 0.006) + blob(points, 0.02, 0, 0.006)
    then = blob(points, -0.02, 0, 0.006) + blob(points, 0.0, 0.025, 0.006)
    foci = focus(points, first, ones(points), sigma=SIGMA)
    for _ in range(2):
        foci = focus(points, then, ones(points), sigma=SIGMA, previous=foci)
    assert foci.count == 2
    expected = np.array([(-0.02, 0, 0.15), (0.0, 0.025, 0.15)])
    assert np.linalg.norm(expected[:, None] - foci.positions[None], axis=2).min(1).max() < 0.5e-3


def test_ceiling_bounds_foci_and_nothing_else():
    """Cap foci that are too strong, and leave the others unchanged."""
    points = skin()
    pressures = blob(points, -0.02, 0, 0.007, 900.0) + blob(points, 0.02, 0, 0.007, 200.0)
    free = focus(points, pressures, ones(points), sigma=SIGMA)
    capped = focus(points, pressures, ones(points), sigma=SIGMA, ceiling=250.0)
    assert np.allclose(capped.pressures, np.minimum(free.pressures, 250.0))
    assert free.pressures.max() > 250.0 > free.pressures.min()


def test_seeding_is_deterministic():
    """Give the same foci for the same field."""
    points = skin()
    pressures = blob(points, 0, 0, 0.04)
    first, second = (focus(points, pressures, ones(points), sigma=SIGMA) for _ in range(2))
    assert np.array_equal(first.positions, second.positions)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 100_000), st.integers(0, 12), st.integers(1, 200))
def test_any_field_gives_valid_foci(seed, count, size):
    """Obey all options on any scattered field, cold and warm-started."""
    random = np.random.default_rng(seed)
    points = random.uniform(-0.05, 0.05, (size, 3)) * random.choice([1.0, 1e-3, 0.0], 3)
    pressures = random.exponential(200.0, size) * (random.random(size) < 0.5)
    foci = focus(points, pressures, random.random(size), sigma=SIGMA, count=count)
    again = focus(
        points, pressures[::-1], random.random(size), sigma=SIGMA, count=count, previous=foci
    )
    for found in (foci, again):
        assert found.count <= count
        assert np.isfinite(found.positions).all()
        assert (found.pressures >= 0.0).all()
        assert found.assignment.max(initial=-1) < max(found.count, 1)
        if found.count:
            assert np.linalg.norm(found.positions[:, None] - points, axis=2).min(1).max() < 0.006


@pytest.mark.parametrize(
    "change",
    [
        {"positions": np.zeros((3, 2))},
        {"pressures": np.array((1.0, np.nan, 0.0))},
        {"pressures": np.array((1.0, -1.0, 0.0))},
        {"weights": np.ones(2)},
        {"sigma": 0.0},
        {"count": -1},
        {"rule": "best"},
    ],
)
def test_bad_input_is_refused(change):
    """Say what is wrong."""
    values = {"positions": np.zeros((3, 3)), "pressures": np.ones(3), "weights": np.ones(3)}
    options = {"sigma": SIGMA} | {k: v for k, v in change.items() if k not in values}
    arrays = [change.get(name, value) for name, value in values.items()]
    with pytest.raises(ValueError, match=r"expected|must be"):
        focus(*arrays, **options)
