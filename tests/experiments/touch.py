# SPDX-License-Identifier: GPL-3.0-or-later
"""What touch comes to: from contacts on a hand to foci, judged against the pressure wanted.

`render_touch` takes any contacts, those of a simulated hand too; the ones made here are of the
generated hand laid flat onto something soft, and of a ball that the solver presses into clay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from tactile_clay.haptics import (
    Foci,
    PressureField,
    Route,
    SkinSensitivity,
    TransducerArray,
    acoustic_field,
    focus,
    plan_route,
    reconstruct,
    solve_drive,
)
from tactile_clay.haptics.acoustics.acoustic_field import propagation
from tactile_clay.haptics.skin.pressure_field import CEILING, GhostContacts
from tactile_clay.solver import Material
from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.tests.haptics.hands import bare_rig, vertex_normals_and_areas

from .press import press

Array = NDArray[np.float64]

PAD_WEIGHT = 0.95
"""Skin of a greater weight is counted as a finger pad."""


@dataclass(frozen=True)
class Contacts:
    """Ghosts and the forces on them, as a solver gives them."""

    positions: Array
    """[m], shape [G, 3]."""
    normals: Array
    """Shape [G, 3]."""
    areas: Array
    """[m²], shape [G]."""
    forces: Array
    """[N], shape [G, 3]."""


@dataclass(frozen=True)
class Misfit:
    """How a rendered pressure differs from the one wanted."""

    error: float
    """Root mean square over area of the difference, over that of the pressure wanted."""
    shape_error: float
    """The same at the best common gain: what is left where strength can be chosen."""
    coverage: float
    """Part of the touched skin that gets half its pressure or more, at the best common gain."""
    gain: float
    """That gain."""


def misfit(found: Array, wanted: Array, areas: Array) -> Misfit:
    """Judge a pressure, all of shape [P]; skin with a fifth of the largest pressure is touched."""
    power = float((areas * wanted * wanted).sum())
    gain = float((areas * found * wanted).sum()) / max(float((areas * found * found).sum()), 1e-30)
    touched = wanted > 0.2 * wanted.max()
    served = touched & (gain * found > 0.5 * wanted)
    return Misfit(
        error=float(np.sqrt((areas * (found - wanted) ** 2).sum() / power)),
        shape_error=float(np.sqrt((areas * (gain * found - wanted) ** 2).sum() / power)),
        coverage=float(areas[served].sum() / areas[touched].sum()),
        gain=gain,
    )


def array_below(name: str = "stratos_explore", height: float = 0.2) -> TransducerArray:
    """An array under the generated hand's palm that faces it."""
    pose = np.eye(4)
    pose[:3, 3] = (0.0, 0.1, -height)
    return TransducerArray.preset(name).placed(pose)


@dataclass(frozen=True)
class Hand:
    """A hand and its perceptual weights."""

    rig: HandRig
    """The hand as it was bound, palm down."""
    skin: SkinSensitivity
    """Perceptual weights."""

    def on_vertices(self, ghosts: NDArray[np.intp], values: Array) -> Array:
        """Values of some ghosts, 0 of the others, at the vertex next to each, shape [V]."""
        told = np.zeros(len(self.skin.ghosts))
        told[ghosts] = values
        places = self.rig.carried_ghosts(self.rig.nodes)
        size = 0.5 * np.square(places).sum(1)
        parts = np.array_split(self.rig.vertices, max(1, len(places) // 500))
        nearest = [(part @ places.T - size).argmax(1) for part in parts]
        return told[np.concatenate(nearest)]


def generated_hand(pose: str = "flat", *, edge_length: float = 0.004) -> Hand:
    """The hand that touches below."""
    rig = bare_rig(pose=pose, edge_length=edge_length)
    return Hand(rig, SkinSensitivity.of(rig))


def sink(hand: Hand, pressure: float = 15e3, *, where: NDArray[np.bool_] | None = None) -> Contacts:
    """Contacts of a hand that has sunk into clay, palm down.

    Clay that flows around a body presses on it nearly evenly, across its surface; less so where
    skin turns away from the way it goes.

    Args:
        hand: The hand.
        pressure: On skin that faces straight down [Pa].
        where: Ghosts that are touched, shape [G]; all below the hand where not given.
    """
    normals, areas = vertex_normals_and_areas(hand.rig.vertices, hand.rig.faces)
    # An arm reaches out of the clay.
    touched = (hand.rig.vertices[:, 1] > 0.0) if where is None else where
    pressed = pressure * np.clip(-normals[:, 2], 0.0, 1.0) * touched
    return Contacts(hand.rig.vertices, normals, areas, -(pressed * areas)[:, None] * normals)


@dataclass(frozen=True)
class Touch:
    """Contacts as foci."""

    field: PressureField
    """What is wanted."""
    foci: Foci
    """Foci of amplitude modulation."""
    rendered: Array
    """Pressure that they give [Pa], shape [F]."""


def render_touch(
    contacts: GhostContacts,
    array: TransducerArray,
    *,
    weights: Array | None = None,
    count: int = 8,
    rule: str = "least_squares",
) -> Touch:
    """Foci for the contacts of any hand.

    Args:
        contacts: Of the hand.
        array: That renders them.
        weights: Perceptual weight of each ghost, shape [G]; even where not given.
        count: Foci at most.
        rule: How foci get their pressures.
    """
    field = PressureField.from_contacts(contacts, array.position, weights=weights)
    foci = focus(
        field.positions,
        field.pressures,
        field.weights,
        count=count,
        sigma=array.wavelength,
        rule=rule,
        ceiling=CEILING,
    )
    return Touch(field, foci, reconstruct(foci, field.positions))


@dataclass(frozen=True)
class WeightsComparison:
    """One contact rendered with perceptual weights and without (the paper's figure 4)."""

    hand: Hand
    """That touches."""
    contacts: Contacts
    """On it."""
    weighted: Touch
    """With weights."""
    even: Touch
    """Without."""

    def on_pads(self, touch: Touch) -> Misfit:
        """How well finger pads are served."""
        return self._on(touch, pads=True)

    def elsewhere(self, touch: Touch) -> Misfit:
        """And the rest of the hand."""
        return self._on(touch, pads=False)

    def _on(self, touch: Touch, *, pads: bool) -> Misfit:
        here = (self.hand.skin.ghosts[touch.field.ghosts] > PAD_WEIGHT) == pads
        field = touch.field
        return misfit(touch.rendered[here], field.pressures[here], field.areas[here])


def compare_weights(hand: Hand, *, count: int = 8) -> WeightsComparison:
    """Render a hand that has sunk into clay, with and without weights."""
    contacts, array = sink(hand), array_below()
    weighted = render_touch(contacts, array, weights=hand.skin.ghosts, count=count)
    even = render_touch(contacts, array, count=count)
    return WeightsComparison(hand, contacts, weighted, even)


@dataclass(frozen=True)
class MaterialTouch:
    """What pressing a clay feels like (the paper's figure 6)."""

    name: str
    """Preset."""
    yield_stress: float
    """[Pa]."""
    force: float
    """On the ball, at full depth and moving [N]."""
    contact_pressure: float
    """Mean over the ball's contact [Pa]."""
    focal_pressure: float
    """Of the strongest focus [Pa]."""


def press_materials(names: Sequence[str]) -> list[MaterialTouch]:
    """Press a fingertip-sized ball into clays and render what it feels.

    The force is the solver's; it is spread evenly over the ball's contact, as theory has it for a
    punch into a plastic body. `render_touch` takes a hand's own contacts in their place.
    """
    radius, depth = 0.012, 0.012
    results = []
    for name in names:
        material = Material.preset(name)
        force = press(depth, radius=radius, material=material).force_moving
        contacts = ball_contacts(radius, depth, force)
        touch = render_touch(contacts, array_below())
        results.append(
            MaterialTouch(
                name,
                material.yield_stress,
                force,
                float(np.average(touch.field.contact_pressures, weights=_pressed(touch))),
                float(touch.foci.pressures.max(initial=0.0)),
            )
        )
    return results


def _pressed(touch: Touch) -> Array:
    return touch.field.areas * (touch.field.contact_pressures > 1.0)


def ball_contacts(radius: float, depth: float, force: float) -> Contacts:
    """Contacts of a ball that is pressed down with a force, even pressure over its contact.

    Args:
        radius: Of the ball [m].
        depth: How deep it went in [m].
        force: Upward, on the ball [N].
    """
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    normals, areas = vertex_normals_and_areas(np.asarray(sphere.vertices), np.asarray(sphere.faces))
    places = np.asarray(sphere.vertices) + np.array((0.0, 0.1, 0.0))
    touching = sphere.vertices[:, 2] < depth - radius
    pressure = force / float((areas * -normals[:, 2])[touching].sum())
    forces = -(pressure * touching * areas)[:, None] * normals
    return Contacts(places, normals, areas, forces)


@dataclass(frozen=True)
class RuleComparison:
    """Equation 9 as printed, and its true minimizer, on one contact."""

    contact: str
    """What is touched."""
    focus_count: int
    """Foci used."""
    true: Misfit
    """With the minimizer."""
    printed: Misfit
    """As printed."""
    gain: float
    """By how much printed pressures are too small."""


def compare_rules(hand: Hand) -> list[RuleComparison]:
    """Reconstruct contacts of several sizes by both rules."""
    array = array_below()
    results = []
    for name, contacts in contact_sizes(hand).items():
        true = render_touch(contacts, array)
        printed = render_touch(contacts, array, rule="printed")
        field = true.field
        results.append(
            RuleComparison(
                name,
                true.foci.count,
                misfit(true.rendered, field.pressures, field.areas),
                misfit(printed.rendered, field.pressures, field.areas),
                float((true.foci.pressures / printed.foci.pressures).mean()),
            )
        )
    return results


def contact_sizes(hand: Hand) -> dict[str, Contacts]:
    """Contacts from one fingertip to the whole hand."""
    along, across = hand.rig.vertices[:, 1], hand.rig.vertices[:, 0]
    index = (hand.skin.distances < 0.003) & (np.abs(across + 0.034) < 0.01) & (along > 0.1)
    palm = (along > 0.0) & (along < 0.095) & (across > -0.045)
    return {
        "one fingertip": sink(hand, where=index),
        "five fingertips": sink(hand, where=hand.skin.distances < 0.003),
        "palm": sink(hand, where=palm),
        "whole hand": sink(hand),
    }


@dataclass(frozen=True)
class ModulationComparison:
    """Amplitude and spatiotemporal modulation of one contact."""

    contact: str
    """What is touched."""
    touched_area: float
    """[m²]."""
    field: PressureField
    """What is wanted."""
    foci: Foci
    """Of amplitude modulation."""
    route: Route
    """Of spatiotemporal modulation."""
    amplitude: Misfit
    """Of the foci's Gaussians."""
    spatiotemporal: Misfit
    """Of the time average of the route's Gaussians."""
    amplitude_sound: Misfit
    """Of the array's simulated sound pressure: foci at once."""
    spatiotemporal_sound: Misfit
    """Time average of the same along the route."""


def compare_modulations(
    hand: Hand, *, count: int = 8, samples: int = 120
) -> list[ModulationComparison]:
    """Render contacts of several sizes by both modulations, with as many foci at a time.

    Args:
        hand: That touches.
        count: Foci at a time, at most.
        samples: Moments of a round that the sound is averaged over.
    """
    array = array_below()
    results = []
    for name, contacts in contact_sizes(hand).items():
        touch = render_touch(contacts, array, count=count)
        field, foci = touch.field, touch.foci
        route = plan_route(field.positions, field.pressures, field.weights, sigma=array.wavelength)
        wanted, areas = field.pressures, field.areas
        loud = np.abs(
            acoustic_field(
                array, solve_drive(array, foci.positions, foci.pressures), field.positions
            )
        )
        results.append(
            ModulationComparison(
                name,
                float(areas[wanted > 0.2 * wanted.max()].sum()),
                field,
                foci,
                route,
                misfit(touch.rendered, wanted, areas),
                misfit(route.time_average(field.positions), wanted, areas),
                misfit(loud, wanted, areas),
                misfit(sound_along(array, route, field.positions, samples), wanted, areas),
            )
        )
    return results


def sound_along(array: TransducerArray, route: Route, points: Array, samples: int = 120) -> Array:
    """Mean over a round of an array's sound pressure at points [Pa, peak], shape [P]."""
    transfer = propagation(array, points)
    total = np.zeros(len(points))
    for sample in range(samples):
        places, pressures = route.at((sample + 0.5) / samples * route.period)
        total += np.abs(transfer @ solve_drive(array, places, pressures))
    return total / samples
