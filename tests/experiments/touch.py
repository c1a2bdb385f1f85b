# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch from contacts on a hand to foci, judged against the wanted pressure.

`render_touch` takes any contacts, including those of a simulated hand; the ones made here are those
of a generated hand laid flat onto something soft, and of a ball that the solver presses into clay.
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
"""Skin with a greater weight counts as finger pad."""


@dataclass(frozen=True)
class Contacts:
    """Ghosts and the forces on them, as a solver reports them."""

    positions: Array
    """Positions of the ghosts [m], shape [G, 3]."""
    normals: Array
    """Outward unit normals, shape [G, 3]."""
    areas: Array
    """Area of skin of each [m²], shape [G]."""
    forces: Array
    """Force on each [N], shape [G, 3]."""


@dataclass(frozen=True)
class Misfit:
    """Difference between rendered and wanted pressure."""

    error: float
    """RMS of the difference over the area, over that of the wanted pressure."""
    shape_error: float
    """The same at the best common gain, that is, regardless of strength."""
    coverage: float
    """Fraction of the touched skin with at least half its pressure at the best common gain."""
    gain: float
    """The best common gain."""


def misfit(found: Array, wanted: Array, areas: Array) -> Misfit:
    """Judge a pressure; skin with over a fifth of the largest pressure counts as touched.

    Args:
        found: Rendered pressure [Pa], shape [P].
        wanted: Wanted pressure [Pa], shape [P].
        areas: Area of skin of each point [m²], shape [P].
    """
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
    """An array under the generated hand's palm, facing it."""
    pose = np.eye(4)
    pose[:3, 3] = (0.0, 0.1, -height)
    return TransducerArray.preset(name).placed(pose)


@dataclass(frozen=True)
class Hand:
    """A hand and its perceptual weights."""

    rig: HandRig
    """The bound hand, palm down."""
    skin: SkinSensitivity
    """Perceptual weights."""

    def on_vertices(self, ghosts: NDArray[np.intp], values: Array) -> Array:
        """Map values of some ghosts, 0 for the others, to the nearest vertices, shape [V]."""
        all_values = np.zeros(len(self.skin.ghosts))
        all_values[ghosts] = values
        places = self.rig.carried_ghosts(self.rig.nodes)
        size = 0.5 * np.square(places).sum(1)
        parts = np.array_split(self.rig.vertices, max(1, len(places) // 500))
        nearest = [(part @ places.T - size).argmax(1) for part in parts]
        return all_values[np.concatenate(nearest)]


def generated_hand(pose: str = "flat", *, edge_length: float = 0.004) -> Hand:
    """A generated hand, palm down."""
    rig = bare_rig(pose=pose, edge_length=edge_length)
    return Hand(rig, SkinSensitivity.of(rig))


def sink(hand: Hand, pressure: float = 15e3, *, where: NDArray[np.bool_] | None = None) -> Contacts:
    """Contacts of a hand sunk into clay, palm down.

    Clay that flows around a body presses on it nearly evenly and normal to its surface, but less
    where the skin faces away from the motion.

    Args:
        hand: The hand.
        pressure: Pressure on skin that faces straight down [Pa].
        where: Whether each ghost is touched, shape [G]; by default all on the hand.
    """
    normals, areas = vertex_normals_and_areas(hand.rig.vertices, hand.rig.faces)
    # The arm reaches out of the clay.
    touched = (hand.rig.vertices[:, 1] > 0.0) if where is None else where
    pressed = pressure * np.clip(-normals[:, 2], 0.0, 1.0) * touched
    return Contacts(hand.rig.vertices, normals, areas, -(pressed * areas)[:, None] * normals)


@dataclass(frozen=True)
class Touch:
    """Contacts rendered as foci."""

    field: PressureField
    """Wanted pressure."""
    foci: Foci
    """Foci of amplitude modulation."""
    rendered: Array
    """Pressure of the foci [Pa], shape [F]."""


def render_touch(
    contacts: GhostContacts,
    array: TransducerArray,
    *,
    weights: Array | None = None,
    count: int = 8,
    rule: str = "least_squares",
) -> Touch:
    """Render the contacts of any hand as foci.

    Args:
        contacts: Contacts of the hand.
        array: The array that renders them.
        weights: Perceptual weight of each ghost, shape [G]; uniform by default.
        count: Largest number of foci.
        rule: Rule for the pressures of foci.
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
    """A contact rendered with and without perceptual weights (the paper's figure 4)."""

    hand: Hand
    """The hand."""
    contacts: Contacts
    """Contacts of the hand."""
    weighted: Touch
    """Rendered with weights."""
    even: Touch
    """Rendered without weights."""

    def on_pads(self, touch: Touch) -> Misfit:
        """Misfit on finger pads."""
        return self._on(touch, pads=True)

    def elsewhere(self, touch: Touch) -> Misfit:
        """Misfit on the rest of the hand."""
        return self._on(touch, pads=False)

    def _on(self, touch: Touch, *, pads: bool) -> Misfit:
        here = (self.hand.skin.ghosts[touch.field.ghosts] > PAD_WEIGHT) == pads
        field = touch.field
        return misfit(touch.rendered[here], field.pressures[here], field.areas[here])


def compare_weights(hand: Hand, *, count: int = 8) -> WeightsComparison:
    """Render a hand sunk into clay, with and without weights."""
    contacts, array = sink(hand), array_below()
    weighted = render_touch(contacts, array, weights=hand.skin.ghosts, count=count)
    even = render_touch(contacts, array, count=count)
    return WeightsComparison(hand, contacts, weighted, even)


@dataclass(frozen=True)
class MaterialTouch:
    """The feel of pressing a clay (the paper's figure 6)."""

    name: str
    """Name of the preset."""
    yield_stress: float
    """Yield stress of the clay [Pa]."""
    force: float
    """Force on the ball at full depth while moving [N]."""
    contact_pressure: float
    """Mean pressure over the ball's contact [Pa]."""
    focal_pressure: float
    """Pressure of the strongest focus [Pa]."""


def press_materials(names: Sequence[str]) -> list[MaterialTouch]:
    """Press a fingertip-sized ball into clays, and render the contact.

    The force is the solver's, spread evenly over the ball's contact as in the theory of a punch
    into a plastic body.
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
    """Contacts of a ball pressed down, with uniform pressure over its contact.

    Args:
        radius: Radius of the ball [m].
        depth: Depth of the press [m].
        force: Upward force on the ball [N].
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
    """Equation 9 as printed and its true minimizer, on one contact."""

    contact: str
    """Name of the contact."""
    focus_count: int
    """Number of foci."""
    true: Misfit
    """Misfit with the minimizer."""
    printed: Misfit
    """Misfit with the equation as printed."""
    gain: float
    """Factor by which pressures as printed are too small."""


def compare_rules(hand: Hand) -> list[RuleComparison]:
    """Reconstruct contacts of several sizes with both rules."""
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
    """Name of the contact."""
    touched_area: float
    """Area of the touched skin [m²]."""
    field: PressureField
    """Wanted pressure."""
    foci: Foci
    """Foci of amplitude modulation."""
    route: Route
    """Route of spatiotemporal modulation."""
    amplitude: Misfit
    """Misfit of the foci's Gaussians."""
    spatiotemporal: Misfit
    """Misfit of the time average of the route's Gaussians."""
    amplitude_sound: Misfit
    """Misfit of the array's simulated sound pressure with all foci at once."""
    spatiotemporal_sound: Misfit
    """Misfit of the time average of the simulated sound pressure along the route."""


def compare_modulations(
    hand: Hand, *, count: int = 8, samples: int = 120
) -> list[ModulationComparison]:
    """Render contacts of several sizes with both modulations.

    Args:
        hand: The hand.
        count: Largest number of simultaneous foci of amplitude modulation.
        samples: Number of times in a round over which the sound is averaged.
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
    """An array's peak sound pressure at points, averaged over a round [Pa], shape [P]."""
    transfer = propagation(array, points)
    total = np.zeros(len(points))
    for sample in range(samples):
        places, pressures = route.at((sample + 0.5) / samples * route.period)
        total += np.abs(transfer @ solve_drive(array, places, pressures))
    return total / samples
