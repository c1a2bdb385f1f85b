# SPDX-License-Identifier: GPL-3.0-or-later
"""The pressure field: forces become pressures that are smoothed, filtered and mapped."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.haptics import PressureField
from tactile_clay.haptics.skin.pressure_field import CEILING, FADE_TIME, GAIN, focal_pressure

SPACING = 0.004
ABOVE = (0.0, 0.0, 0.3)


@dataclass(frozen=True)
class Contacts:
    """Ghosts as a solver gives them."""

    positions: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    forces: np.ndarray


def sheet(count: int = 15, seed: int = 0) -> Contacts:
    """A flat piece of skin that faces up, with ghosts on a jittered grid."""
    random = np.random.default_rng(seed)
    grid = (np.arange(count) - 0.5 * (count - 1)) * SPACING
    positions = np.stack(np.meshgrid(grid, grid, [0.0], indexing="ij"), -1).reshape(-1, 3)
    positions[:, :2] += random.uniform(-0.2, 0.2, (len(positions), 2)) * SPACING
    areas = SPACING**2 * random.uniform(0.7, 1.3, len(positions))
    normals = np.tile((0.0, 0.0, 1.0), (len(positions), 1))
    return Contacts(positions, normals, areas, np.zeros_like(positions))


def pressed(contacts: Contacts, pressure) -> Contacts:
    """The contacts under a pressure [Pa], either uniform or one value per ghost."""
    force = -np.asarray(pressure)[..., None] * contacts.areas[:, None] * contacts.normals
    return replace(contacts, forces=force)


def test_uniform_pressure_is_unchanged():
    """Recover a uniform pressure from the forces, up to the edge of the sheet."""
    field = PressureField.from_contacts(pressed(sheet(), 20e3), ABOVE)
    assert np.allclose(field.contact_pressures, 20e3, rtol=1e-3)
    assert np.allclose(field.pressures, focal_pressure(20e3), rtol=1e-3)
    assert (field.weights == 1.0).all()


def test_smoothing_keeps_the_force():
    """Preserve ∫ p dA of a point load, and spread it over about one spacing."""
    contacts = sheet()
    load = np.zeros(len(contacts.areas))
    load[len(load) // 2] = 50e3
    field = PressureField.from_contacts(pressed(contacts, load), ABOVE)
    force = load @ contacts.areas
    assert field.contact_pressures @ field.areas == pytest.approx(force, rel=1e-9)
    share = field.contact_pressures * field.areas / force
    offset = field.positions - contacts.positions[len(load) // 2]
    spread = np.sqrt(share @ np.square(offset[:, :2]).sum(1) / 2.0)
    assert 0.6 * SPACING < spread < 1.2 * SPACING


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_smoothing_keeps_any_force(seed):
    """Preserve the total force of any load on irregular skin."""
    contacts = sheet(9, seed)
    load = np.random.default_rng(seed).exponential(1e4, len(contacts.areas))
    field = PressureField.from_contacts(pressed(contacts, load), ABOVE)
    assert field.contact_pressures @ field.areas == pytest.approx(load @ contacts.areas, rel=1e-9)


def test_only_compression_counts():
    """Use the normal component of a force, and ignore tension and shear."""
    contacts = sheet()
    pulled = PressureField.from_contacts(pressed(contacts, -5e3), ABOVE)
    assert (pulled.pressures == 0.0).all()
    slanted = pressed(contacts, 5e3)
    slanted = replace(slanted, forces=slanted.forces + np.array((0.3, -0.2, 0.0)))
    field = PressureField.from_contacts(slanted, ABOVE)
    assert np.allclose(field.contact_pressures, 5e3, rtol=1e-3)


def test_skin_that_faces_away_is_left_out():
    """Include only skin that faces the array, unaffected by the load on the other side."""
    up = pressed(sheet(), 10e3)
    down = replace(pressed(sheet(), 30e3), normals=-up.normals)
    both = Contacts(
        np.concatenate([up.positions, down.positions - (0, 0, SPACING)]),
        np.concatenate([up.normals, down.normals]),
        np.concatenate([up.areas, down.areas]),
        np.concatenate([up.forces, -down.forces]),
    )
    count = len(up.areas)
    field = PressureField.from_contacts(both, ABOVE)
    assert field.ghosts.max() < count
    assert np.allclose(field.contact_pressures, 10e3, rtol=1e-3)
    under = PressureField.from_contacts(both, (0, 0, -0.3))
    assert under.ghosts.min() >= count
    assert np.allclose(under.contact_pressures, 30e3, rtol=1e-3)


def test_force_inside_counts_for_the_nearest_skin():
    """Add the force on inner ghosts to the surface."""
    contacts = sheet()
    inner = Contacts(
        np.vstack((contacts.positions, (0, 0, -0.004))),
        np.vstack((contacts.normals, (0, 0, 0))),
        np.append(contacts.areas, 0.0),
        np.vstack((contacts.forces, (0, 0, -0.5))),
    )
    field = PressureField.from_contacts(inner, ABOVE)
    assert field.contact_pressures @ field.areas == pytest.approx(0.5)
    assert len(field.pressures) == len(contacts.areas)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(1e-4, 0.2), min_size=1, max_size=8))
def test_fading_does_not_depend_on_the_time_step(steps):
    """Follow a load by 1 − e^{−t / 30 ms}, however the time is divided into frames."""
    contacts = sheet(5)
    field = PressureField.from_contacts(contacts, ABOVE)
    for dt in steps:
        field = PressureField.from_contacts(pressed(contacts, 10e3), ABOVE, previous=field, dt=dt)
    expected = 10e3 * -np.expm1(-sum(steps) / FADE_TIME)
    assert np.allclose(field.contact_pressures, expected, rtol=1e-3)


def test_skin_that_turns_away_fades():
    """Fade skin that turns away from the array like skin that is no longer touched."""
    contacts = pressed(sheet(5), 10e3)
    field = PressureField.from_contacts(contacts, ABOVE)
    field = PressureField.from_contacts(contacts, (0, 0, -1), previous=field, dt=FADE_TIME)
    assert np.allclose(field.contact_pressures, 10e3 / np.e, rtol=1e-3)
    for _ in range(20):
        field = PressureField.from_contacts(contacts, (0, 0, -1), previous=field, dt=FADE_TIME)
    assert len(field.pressures) == 0


@settings(max_examples=50, deadline=None)
@given(st.floats(0, 1e6), st.floats(1e-3, 1e5), st.floats(1e-3, 1.0), st.floats(10.0, 5e3))
def test_the_map_to_focal_pressure_rises_below_its_ceiling(pressure, more, gain, ceiling):
    """Increase with contact pressure up to the ceiling, with slope `gain` for a light touch."""
    low, high = focal_pressure([pressure, pressure + more], gain=gain, ceiling=ceiling)
    assert 0.0 <= low <= high <= ceiling
    assert high > low or high > 0.999999 * ceiling
    assert focal_pressure(1e-3, gain=gain, ceiling=ceiling) == pytest.approx(1e-3 * gain, rel=1e-3)


def test_the_map_suits_the_pressure_of_clay():
    """Spread soft to stiff clay (6 τ_y for 1, 5 and 25 kPa) over the range of an array."""
    soft, medium, stiff = focal_pressure([6e3, 30e3, 150e3])
    assert 150.0 < soft < 300.0
    assert 600.0 < medium < 800.0
    assert 950.0 < stiff < CEILING
    assert soft == pytest.approx(6e3 * GAIN, rel=0.15)


def test_ghosts_that_are_not_finite_are_dropped():
    """Keep NaN out of the field, count it, and keep the previous state of that ghost."""
    contacts = pressed(sheet(5), 10e3)
    field = PressureField.from_contacts(contacts, ABOVE)
    broken = replace(contacts, forces=contacts.forces.copy())
    broken.forces[3] = np.nan
    after = PressureField.from_contacts(broken, ABOVE, previous=field, dt=0.01)
    assert after.dropped == 1
    assert 3 not in after.ghosts
    assert np.isfinite(after.pressures).all()
    again = PressureField.from_contacts(contacts, ABOVE, previous=after, dt=0.01)
    assert np.allclose(again.contact_pressures, 10e3, rtol=0.15)


def test_two_hands_make_one_field():
    """Join the fields of two hands, and of no hands."""
    first = PressureField.from_contacts(pressed(sheet(4), 10e3), ABOVE)
    second = PressureField.from_contacts(pressed(sheet(5), 20e3), ABOVE)
    both = PressureField.joined([first, second])
    assert len(both.pressures) == 16 + 25
    assert both.pressures[-1] == second.pressures[-1]
    assert len(PressureField.joined([]).pressures) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weights": np.ones(3)}, "expected"),
        ({"gain": 0.0}, "gain"),
        ({"ceiling": np.inf}, "ceiling"),
        ({"previous": 1}, "dt"),
        ({"previous": 2, "dt": 0.01}, "bound again"),
    ],
)
def test_bad_input_is_refused(options, message):
    """Say what is wrong."""
    if "previous" in options:
        options = options | {"previous": PressureField.from_contacts(sheet(4), ABOVE)}
    with pytest.raises(ValueError, match=message):
        PressureField.from_contacts(sheet(5), ABOVE, **options)
