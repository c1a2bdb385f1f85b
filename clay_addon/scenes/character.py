# SPDX-License-Identifier: GPL-3.0-or-later
"""The character: a bust of Suzanne, modelled with tools from wax of six colors.

She is blocked out without eyes, mouth or hat. Pellets of other wax have been set on her face and
chest, and a beret on her head, as lightly as they stick. Tools then press the eyes flat, push the
beret down all around, print a smile, hollow the ears and press a badge on.

All of it are ordinary objects with modifiers and keyframes, to be changed by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

import bpy
import numpy as np
from mathutils import Vector

from ..clay.make_clay import make_clay
from ..core.tools.presets import load_tool_preset
from ..model.collider import make_collider
from .character_parts import HEAD, Skin, add_ball, add_bust
from .character_tools import ModellingTool, Spot, bow_shape, mirrored
from .parts import Vec3, mesh_object, plain_material
from .stage import (
    add_area_light,
    add_camera,
    add_room_light,
    look_through_camera,
    set_clock_and_units,
    set_render,
)

SPACING = 0.003
"""Distance between particles [m]."""
FRAME_COUNT = 170

_SKIN = (0.46, 0.20, 0.095)
_TEAL = (0.015, 0.19, 0.21)
_RED = (0.60, 0.030, 0.022)
_YELLOW = (0.80, 0.46, 0.035)
_WHITE = (0.80, 0.77, 0.69)
_BLACK = (0.018, 0.015, 0.014)
_STEEL = (0.35, 0.36, 0.38)
_RUBBER = (0.30, 0.10, 0.055)

_EYE = (0.215, 1.165)
_BADGE = (0.0, 0.24)
_EAR = (0.55, 1.09)
_NOSTRIL = (0.078, 0.880)
"""Places of the left side of her face in the front view: x and z [heads]."""
_SMILE, _SMILE_RADIUS = (0.0, 0.700), 0.140
"""Where its middle is, likewise, and its bend [heads]."""
_EYE_RADIUS, _PUPIL_RADIUS, _BADGE_RADIUS, _BOBBLE_RADIUS = 0.128, 0.078, 0.118, 0.095
_BERET = (0.42, 0.40, 0.115)
"""Radii [heads]."""
_STICKINESS = 20000.0
"""Of the board, onto which the bust was pressed: it must not slide or rock [Pa]."""


@dataclass(frozen=True)
class Character:
    """What the scene is made of."""

    clay: bpy.types.Object
    """The clay, a point cloud."""
    pieces: tuple[bpy.types.Object, ...]
    """The meshes it was made from, hidden."""
    tools: tuple[bpy.types.Object, ...]
    """Colliders, keyed."""


def build(context: bpy.types.Context) -> Character:
    """Build the scene into an empty Blender scene, ready to bake and to render.

    Args:
        context: Its scene is filled.
    """
    scene = context.scene
    scene.name = "Character"
    set_clock_and_units(scene, FRAME_COUNT)
    _add_board(context)
    bust = add_bust(_SKIN)
    skin = Skin(bust)
    pieces = (bust, *_add_pellets(skin), *_add_beret(skin), *_add_rest())
    clay = make_clay(context, pieces, SPACING, "wax", "Modelling wax")
    tools = _add_tools(context, skin, pieces)
    _add_stage(context)
    return Character(clay, pieces, tools)


def _on(skin: Skin, place: tuple[float, float]) -> Spot:
    """A spot of the front view [heads]."""
    return skin.front(HEAD * place[0], HEAD * place[1])


def _add_pellets(skin: Skin) -> list[bpy.types.Object]:
    """Set pellets for eyes, pupils and a badge on the skin, so that they just stick."""
    items = []
    place, out = _eye(skin)
    for side, name in ((1.0, "left"), (-1.0, "right")):
        for kind, height, radius, color in (
            # Sunk into the eye, which leaves room for it.
            ("Pupil", 1.5 * _EYE_RADIUS, _PUPIL_RADIUS, _BLACK),
            ("Eye", 0.85 * _EYE_RADIUS, _EYE_RADIUS, _WHITE),
        ):
            middle = place + HEAD * height * out
            middle.x *= side
            items.append(add_ball(f"{kind}, {name}", middle, HEAD * radius, color))
    place, out = _on(skin, _BADGE)
    middle = place + HEAD * 0.8 * _BADGE_RADIUS * out
    items.append(add_ball("Badge", middle, HEAD * _BADGE_RADIUS, _YELLOW))
    return items


def _eye(skin: Skin) -> Spot:
    """Where an eye goes, and how it looks out: forward, a little up and to the side."""
    place, _ = _on(skin, _EYE)
    return place, Vector((0.12, -1.0, 0.12)).normalized()


def _add_beret(skin: Skin) -> list[bpy.types.Object]:
    """Lay a beret with a bobble on the head, askew."""
    top = skin.met((0.07 * HEAD, 0.04 * HEAD, 1.0), (0.0, 0.0, -1.0))[0]
    radii = tuple(HEAD * radius for radius in _BERET)
    middle = top + Vector((0.0, 0.0, 0.75 * radii[2]))
    beret = add_ball("Beret", middle, (radii[0], radii[1], radii[2]), _TEAL)
    beret.rotation_euler = (0.12, 0.20, 0.0)
    bpy.context.view_layer.update()
    crown, out = Skin(beret).met((middle.x, middle.y, 1.0), (0.0, 0.0, -1.0))
    radius = HEAD * _BOBBLE_RADIUS
    return [beret, add_ball("Bobble", crown + 0.85 * radius * out, radius, _RED)]


def _add_rest() -> list[bpy.types.Object]:
    """Lay what clay was left over on the board."""
    return [
        add_ball(name, Vector((x, y, radius)), radius, color)
        for name, x, y, radius, color in (
            ("Red left over", 0.098, -0.018, 0.0125, _RED),
            ("Yellow left over", 0.089, -0.047, 0.0095, _YELLOW),
            ("Teal left over", 0.117, -0.042, 0.0110, _TEAL),
        )
    ]


def _add_tools(
    context: bpy.types.Context, skin: Skin, pieces: Sequence[bpy.types.Object]
) -> tuple[bpy.types.Object, ...]:
    tools: list[ModellingTool] = []

    def tool(name: str, preset: str, radius: float, color: Vec3, handle: float) -> ModellingTool:
        kind = load_tool_preset(preset)
        shape = kind.fitted(radius, SPACING), kind.faces
        made = ModellingTool(
            context, name, shape, friction=kind.friction, color=color, handle=handle
        )
        tools.append(made)
        return made

    # Who presses on a head, holds it from behind.
    for name, height in (("head", 1.14), ("nape", 0.55)):
        behind = skin.met((0.0, 1.0, height * HEAD), (0.0, -1.0, 0.0))[0]
        palm = tool(f"Palm behind, {name}", "palm", 0.012, _RUBBER, 0.0)
        palm.press((behind, Vector((0.0, 1.0, 0.0))), -0.3 * SPACING, (-16, 1, 144, 152))

    eye = _eye(skin)
    for side, spot in (("left", eye), ("right", mirrored(eye))):
        paddle = tool(f"Paddle, {side}", "paddle", 0.0135, (0.42, 0.22, 0.09), 0.004)
        paddle.press(spot, -0.105 * HEAD, (4, 34, 40, 52))

    beret = pieces[[piece.name for piece in pieces].index("Beret")]
    finger = tool("Finger", "finger", 0.0095, _RUBBER, 0.0045)
    hat = Skin(beret)
    for number, angle in enumerate(np.radians((-100.0, -40.0, 20.0, 80.0, 140.0, 200.0))):
        reach = 0.78 * HEAD
        x = beret.location.x + reach * _BERET[0] * float(np.cos(angle))
        y = beret.location.y + reach * _BERET[1] * float(np.sin(angle))
        place, out = hat.met((x, y, 1.0), (0.0, 0.0, -1.0))
        start = 1 + 20 * number
        finger.press((place, (out + Vector((0.0, 0.0, 1.2))).normalized()), 0.16 * HEAD,
                     (start, start + 9, start + 11, start + 18))  # fmt: skip

    bow = bow_shape(_SMILE_RADIUS * HEAD, 0.042 * HEAD, radians(58.0))
    smile = ModellingTool(context, "Bow", bow, friction=0.1, color=_STEEL, handle=0.0030)
    tools.append(smile)
    place, _ = _on(skin, _SMILE)
    smile.press((place, Vector((0.0, -1.0, 0.0))), 0.072 * HEAD, (58, 78, 82, 98))

    stylus = tool("Stylus", "ball", 0.0052, _STEEL, 0.0032)
    for start, spot in ((108, _on(skin, _NOSTRIL)), (132, mirrored(_on(skin, _NOSTRIL)))):
        stylus.press(spot, 0.085 * HEAD, (start, start + 9, start + 11, start + 20))

    front = _on(skin, _EAR)
    back = skin.met((HEAD * _EAR[0], 1.0, HEAD * _EAR[1]), (0.0, -1.0, 0.0))
    inward = (back[0] - front[0]).normalized()
    for side in ("left", "right"):
        hollow = tool(f"Ball, {side}", "ball", 0.0092, _STEEL, 0.004)
        hold = tool(f"Finger behind, {side}", "finger", 0.0100, _RUBBER, 0.0)
        one, other = (front[0], -inward), (back[0], inward)
        if side == "right":
            one, other = mirrored(one), mirrored(other)
        hollow.press(one, 0.100 * HEAD, (60, 84, 88, 104))
        hold.press(other, 0.0, (56, 74, 92, 106))

    thumb = tool("Thumb", "finger", 0.0125, _RUBBER, 0.005)
    thumb.press(_on(skin, _BADGE), -0.030 * HEAD, (100, 126, 130, 142))
    return tuple(made.write() for made in tools)


# Board, light and camera -----------------------------------------------------------------------


def _add_board(context: bpy.types.Context) -> None:
    """Add a round board, to the clay an infinite plane, on paper that bends up behind it."""
    angles = np.linspace(0.0, 2.0 * np.pi, 128, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(128)], axis=1)
    top = mesh_object("Board", 0.158 * circle, [range(128)])
    top.data.materials.append(plain_material("Board", (0.50, 0.33, 0.18), 0.45))
    context.view_layer.update()
    make_collider(top, "PLANE", 2.0)
    top.tactile_clay.collider_adhesion = _STICKINESS
    rings = [
        radius * circle + (0.0, 0.0, height)
        for radius, height in ((0.158, 0.0), (0.160, -0.002), (0.160, -0.012), (0.158, -0.014))
    ]
    faces = [
        (128 * r + 128 + n, 128 * r + 128 + (n + 1) % 128, 128 * r + (n + 1) % 128, 128 * r + n)
        for r in range(3)
        for n in range(128)
    ]
    rim = mesh_object("Board, rim", np.concatenate(rings), faces)
    rim.data.materials.append(top.data.materials[0])
    bend = np.linspace(0.0, 0.5 * np.pi, 24)
    profile = [
        (-1.2, 0.0),
        *zip(0.45 + 0.3 * np.sin(bend), 0.3 - 0.3 * np.cos(bend), strict=True),
        (0.75, 1.4),
    ]
    points = [(x, y, z - 0.014) for y, z in profile for x in (-1.6, 1.6)]
    paper = mesh_object(
        "Paper",
        np.array(points),
        [(2 * n, 2 * n + 1, 2 * n + 3, 2 * n + 2) for n in range(len(profile) - 1)],
    )
    paper.data.shade_smooth()
    paper.data.materials.append(plain_material("Paper", (0.30, 0.34, 0.33), 0.9))


def _add_stage(context: bpy.types.Context) -> None:
    for name, place, energy, size, color in (
        ("Window", (-0.55, -0.60, 0.60), 14.0, 0.40, (1.0, 0.90, 0.78)),
        ("Rim", (0.60, 0.45, 0.50), 7.0, 0.25, (1.0, 0.93, 0.85)),
        ("Fill", (0.70, -0.60, 0.25), 2.0, 0.60, (0.80, 0.90, 1.0)),
    ):
        add_area_light(context, name, place, energy, size, color)
    add_room_light(context, 0.13)
    camera = add_camera(context, (-0.19, -0.74, 0.165), (0.022, 0.0, 0.084), lens=85.0)
    camera.data.dof.use_dof = True
    camera.data.dof.focus_distance = 0.72
    camera.data.dof.aperture_fstop = 8.0
    set_render(context.scene, 960, 600)
    look_through_camera(context)
