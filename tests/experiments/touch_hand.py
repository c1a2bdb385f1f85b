# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand, soft, pressed into clay by the solver, and what an array lets it feel.

The paper's figures 4 and 6 from this simulation.
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
    """A hand at full depth, still moving."""

    material: str
    """The clay's preset."""
    yield_stress: float
    """Of the clay [Pa]."""
    force: float
    """On the hand, upward [N]."""
    touch: WeightsComparison
    """Rendered with and without perceptual weights."""

    @property
    def touched_area(self) -> float:
        """Skin under more than a kilopascal [m²]."""
        field = self.touch.even.field
        return float(field.areas[field.contact_pressures > 1e3].sum())

    @property
    def contact_pressure(self) -> float:
        """Mean over that skin [Pa]."""
        field = self.touch.even.field
        pressed = field.contact_pressures > 1e3
        return float(np.average(field.contact_pressures[pressed], weights=field.areas[pressed]))


def press_hands(
    names: Sequence[str], *, depth: float = 0.01, spacing: float = SPACING
) -> list[HandPress]:
    """Press the default hand into clay that bears its print, palm down, one after another.

    Args:
        names: Presets of the clays.
        depth: How far the hand goes down from where its whole palm side touches [m].
        spacing: Of the clay's particles [m].
    """
    rig = default_hand_rig("right", clay_spacing=spacing)
    hand = Hand(rig, SkinSensitivity.of(rig))
    return [_press(hand, name, depth, spacing) for name in names]


def _press(hand: Hand, name: str, depth: float, spacing: float) -> HandPress:
    material = Material.preset(name)
    rig = hand.rig
    points, floor = _mould(hand, depth, spacing)
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
    told = solver.contacts(pressing)
    contacts = Contacts(told.positions, told.normals, told.areas, told.forces)
    array = array_below()
    touch = WeightsComparison(
        hand,
        contacts,
        render_touch(contacts, array, weights=hand.skin.ghosts),
        render_touch(contacts, array),
    )
    return HandPress(name, material.yield_stress, float(solver.force_on(pressing)[2]), touch)


def _mould(hand: Hand, depth: float, spacing: float) -> tuple[NDArray[np.float64], float]:
    """Clay that the hand's whole palm side meets at once: its print, a little wider.

    Args:
        hand: The hand, palm down.
        depth: How deep it will go [m].
        spacing: Of the particles [m].

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
    """Pressure on the hand and the foci that stand for it, a column for each clay."""
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
    """The report's part on it, with its pictures."""
    presses = press_hands(MATERIALS)
    chosen = next(p for p in presses if p.material == "plasticine")
    touch_pictures.draw_weights(chosen.touch, folder / "touch_hand_weights.png")
    draw_presses(presses, folder / "touch_hand_materials.png")
    lines = [
        "### The solver's own hand",
        "",
        "The default hand, soft, pressed 10 mm deeper into clay that bears its print, at 60 mm/s: "
        "into plasticine, rendered without and with perceptual weights, and into clays of rising "
        "yield stress.",
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
