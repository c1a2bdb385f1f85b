# SPDX-License-Identifier: GPL-3.0-or-later
"""The default soft hand pressed into clay by the solver, and rendered by an array.

Reproduces the paper's figures 4 and 6 from this simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture
from numpy.typing import NDArray

from tactile_clay.haptics import SkinSensitivity
from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.hand.default_hand import default_hand_rig
from tactile_clay.tests.haptics.hands import vertex_normals_and_areas

from . import touch_pictures
from .shapes import block
from .touch import Contacts, Hand, WeightsComparison, array_below, render_touch

SPACING = 0.006
SPEED = 0.06
FRAME = 1.0 / 60.0
MATERIALS = ("wet_clay", "soft_play_dough", "plasticine", "throwing_clay")


@dataclass(frozen=True)
class HandPress:
    """A hand pressed to full depth, still moving."""

    material: str
    """Preset of the clay."""
    yield_stress: float
    """Yield stress of the clay [Pa]."""
    force: float
    """Upward force on the hand [N]."""
    touch: WeightsComparison
    """Touch with and without perceptual weights."""

    @property
    def touched_area(self) -> float:
        """Area of skin under more than a kilopascal [m²]."""
        field = self.touch.even.field
        return float(field.areas[field.contact_pressures > 1e3].sum())

    @property
    def contact_pressure(self) -> float:
        """Mean pressure over that skin [Pa]."""
        field = self.touch.even.field
        pressed = field.contact_pressures > 1e3
        return float(np.average(field.contact_pressures[pressed], weights=field.areas[pressed]))


def press_hands(
    names: Sequence[str], *, depth: float = 0.01, spacing: float = SPACING
) -> list[HandPress]:
    """Press the default hand, palm down, into clays that bear its imprint.

    Args:
        names: Presets of the clays.
        depth: How far the hand moves down after its whole palm side touches [m].
        spacing: Particle spacing [m].
    """
    rig = default_hand_rig("right", clay_spacing=spacing)
    hand = Hand(rig, SkinSensitivity.of(rig))
    return [_press(hand, name, depth, spacing) for name in names]


def _press(hand: Hand, name: str, depth: float, spacing: float) -> HandPress:
    material = Material.preset(name)
    rig = hand.rig
    points, floor = _mold(hand, depth, spacing)
    scene = Scene(spacing)
    scene.add_clay(points, material)
    scene.add_plane((0.0, 0.0, floor), (0.0, 0.0, 1.0))
    pressing = scene.add_hand(rig)
    solver = Solver(scene)
    solver.begin()
    for _ in range(6):
        solver.step(FRAME)
    for step in range(round((depth + 0.5 * spacing) / (SPEED * FRAME))):
        down = np.eye(4)
        down[2, 3] = -(step + 1) * SPEED * FRAME
        places = zip(rig.bone_names, rig.bone_rest, strict=True)
        pressing.set_bones({bone: down @ rest for bone, rest in places})
        solver.step(FRAME)
    reported = solver.contacts(pressing)
    contacts = Contacts(reported.positions, reported.normals, reported.areas, reported.forces)
    array = array_below()
    touch = WeightsComparison(
        hand,
        contacts,
        render_touch(contacts, array, weights=hand.skin.ghosts),
        render_touch(contacts, array),
    )
    return HandPress(name, material.yield_stress, float(solver.force_on(pressing)[2]), touch)


def _mold(hand: Hand, depth: float, spacing: float) -> tuple[NDArray[np.float64], float]:
    """Make clay that the hand's whole palm side touches at once: its imprint, slightly widened.

    Args:
        hand: The hand, palm down.
        depth: Depth of the press to come [m].
        spacing: Particle spacing [m].

    Returns:
        Particles [m], shape [N, 3], and the height of the table [m].
    """
    vertices, faces = hand.rig.vertices, hand.rig.faces
    normals, _ = vertex_normals_and_areas(vertices, faces)
    # The forearm stays outside.
    below = vertices[(normals[:, 2] < 0.0) & (vertices[:, 1] > -0.005)]
    low, high = below.min(0), below.max(0)
    floor = float(low[2]) - depth - 2.5 * spacing
    size = high - np.array((low[0], low[1], floor))
    counts = np.ceil(size / spacing).astype(int) + np.array((4, 4, 0))
    base = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), floor)
    points = block((int(counts[0]), int(counts[1]), int(counts[2])), spacing, base)
    kept = np.zeros(len(points), bool)
    for part in np.array_split(np.arange(len(points)), len(points) // 500 + 1):
        away = np.linalg.norm(points[part, None, :2] - below[None, :, :2], axis=2)
        reach = np.maximum(away.min(1), 1.2 * spacing)[:, None] + 1e-9
        near = np.where(away < reach, below[:, 2], np.inf)
        kept[part] = (points[part, 2] < near.min(1) - 0.5 * spacing) & (away.min(1) < 0.015)
    return points[kept], floor


def draw_presses(presses: Sequence[HandPress], path: Path) -> None:
    """Draw the pressure on the hand and the foci that render it, one column per clay."""
    picture = Picture(
        figsize=(2.7 * len(presses), 4.3), dpi=150, facecolor=touch_pictures.PAPER,
        layout="constrained",
    )  # fmt: skip
    panels = list(np.atleast_1d(picture.subplots(1, len(presses))))
    top = max(float(p.touch.weighted.field.pressures.max()) for p in presses)
    for axes, press in zip(panels, presses, strict=True):
        shown = press.touch.weighted
        values = press.touch.hand.on_vertices(shown.field.ghosts, shown.field.pressures)
        title = f"{press.material.replace('_', ' ')}\n{press.force:.0f} N"
        touch_pictures.draw_palm(axes, press.touch.hand, values, title, top=top)
        touch_pictures.draw_foci(axes, shown.foci, top)
    touch_pictures.draw_scale(picture, panels, top, "Pa")
    picture.savefig(path)


def press_lines(folder: Path) -> list[str]:
    """Lines of the report's section, and its pictures."""
    presses = press_hands(MATERIALS)
    chosen = next(p for p in presses if p.material == "plasticine")
    touch_pictures.draw_weights(chosen.touch, folder / "touch_hand_weights.png")
    draw_presses(presses, folder / "touch_hand_materials.png")
    lines = [
        "### The solver's hand",
        "",
        "The default soft hand is pressed 10 mm deep into clay that bears its imprint, at 60 mm/s: "
        "into plasticine, rendered without and with perceptual weights, and into clays of "
        "increasing yield stress.",
        "",
        "![A hand in plasticine](touch_hand_weights.png)",
        "",
        "![A hand in four clays](touch_hand_materials.png)",
        "",
        "| clay | yield stress | force | touched skin | pressure of the clay | foci "
        "| strongest, mean | error on pads without weights | with |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for p in presses:
        t, foci = p.touch, p.touch.weighted.foci
        lines.append(
            f"| {p.material.replace('_', ' ')} | {1e-3 * p.yield_stress:g} kPa | {p.force:.1f} N "
            f"| {1e4 * p.touched_area:.0f} cm² | {1e-3 * p.contact_pressure:.1f} kPa "
            f"| {foci.count} | {foci.pressures.max():.0f}, {foci.pressures.mean():.0f} Pa "
            f"| {t.on_pads(t.even).error:.0%} | {t.on_pads(t.weighted).error:.0%} |"
        )
    return [*lines, ""]
