# SPDX-License-Identifier: GPL-3.0-or-later
"""The two hands of the kindergarten scene, and what they do in two seconds.

First the right hand presses flat on the red block, while the left pinches the head off the
caterpillar. Then both push the yellow and the blue block together. Finally the left index finger
presses a dent into the violet block.

Both are default hands: ordinary armatures with keyframes for the object and every bone.
"""

from __future__ import annotations

from dataclasses import replace

import bpy

from ...solver.hand.shape import POSES
from ..hands.add_hand import add_hand
from ..hands.reading import hand_armature
from .hand_keys import HandHold, HandKey, add_sleeve, key_hand

HAND_LENGTH = 0.15
"""From wrist to fingertip of a nine-year-old child [m]."""
_FRICTION = 0.8
"""Coulomb friction coefficient of a child's hands, which are not clean."""


_FLAT = HandHold(
    replace(
        POSES["flat"],
        index=(-5.0, -4.0, 4.0, 4.0),
        middle=(0.0, -4.0, 4.0, 4.0),
        ring=(5.0, -4.0, 4.0, 4.0),
        little=(11.0, -4.0, 4.0, 4.0),
        thumb=(-10.0, 16.0, 0.0, 8.0, 4.0),
    ),
    forward=(0.12, -1.0, -0.10),
    back=(0.0, 0.0, 1.0),
    anchor=("middle_proximal", "ring_proximal"),
)
_PINCHED_POSE = replace(
    POSES["pinch"],
    index=(-4.0, 37.0, 64.0, 36.0),
    middle=(2.0, 4.0, 22.0, 14.0),
    ring=(5.0, -4.0, 22.0, 14.0),
    little=(10.0, -8.0, 22.0, 14.0),
    thumb=(26.0, 15.0, 57.0, 0.0, 1.0),
)
_PINCH_ANCHOR = ("thumb_tip", "index_tip")
_PINCHED = HandHold(
    _PINCHED_POSE, forward=(-0.30, -0.92, -0.26), back=(0.0, 0.0, 1.0), anchor=_PINCH_ANCHOR
)
_OPEN = replace(
    _PINCHED,
    pose=replace(_PINCHED_POSE, index=(-6.0, 25.0, 44.0, 22.0), thumb=(12.0, 13.0, 50.0, 0.0, 0.0)),
)
_PUSH_POSE = replace(
    POSES["flat"],
    index=(-2.0, 2.0, 3.0, 2.0),
    middle=(0.0, 2.0, 3.0, 2.0),
    ring=(2.0, 2.0, 3.0, 2.0),
    little=(5.0, 2.0, 3.0, 2.0),
    thumb=(-12.0, 10.0, 0.0, 10.0, 8.0),
)
_PUSH_ANCHOR = ("middle_proximal", "ring_proximal", "middle_intermediate", "ring_intermediate")
_PUSH_RIGHT = HandHold(_PUSH_POSE, (0.05, -1.0, -0.16), (-1.0, 0.0, 0.0), _PUSH_ANCHOR)
_PUSH_LEFT = HandHold(_PUSH_POSE, (-0.05, -1.0, -0.16), (1.0, 0.0, 0.0), _PUSH_ANCHOR)
_POINT = HandHold(POSES["point"], (-0.15, -0.80, -0.55), (0.0, 0.0, 1.0), ("index_tip",))

_RIGHT = (
    HandKey(1, _FLAT, (-0.106, 0.036, 0.075)),
    HandKey(8, _FLAT, (-0.106, 0.014, 0.056)),
    HandKey(38, _FLAT, (-0.106, 0.010, 0.0255)),
    HandKey(46, _FLAT, (-0.106, 0.010, 0.0255)),
    HandKey(56, _FLAT, (-0.104, 0.040, 0.075)),
    HandKey(68, _PUSH_RIGHT, (-0.058, 0.047, 0.037)),
    HandKey(88, _PUSH_RIGHT, (-0.036, 0.047, 0.037)),
    HandKey(92, _PUSH_RIGHT, (-0.036, 0.047, 0.037)),
    HandKey(99, _PUSH_RIGHT, (-0.058, 0.047, 0.040)),
    HandKey(120, _PUSH_RIGHT, (-0.110, 0.130, 0.090)),
)
_LEFT = (
    HandKey(1, _OPEN, (0.092, -0.030, 0.050)),
    HandKey(10, _OPEN, (0.085, -0.050, 0.0125)),
    HandKey(24, _PINCHED, (0.085, -0.050, 0.0090)),
    HandKey(42, _PINCHED, (0.138, -0.050, 0.022)),
    HandKey(48, _OPEN, (0.140, -0.050, 0.025)),
    HandKey(57, _OPEN, (0.120, -0.010, 0.075)),
    HandKey(68, _PUSH_LEFT, (0.058, 0.047, 0.037)),
    HandKey(88, _PUSH_LEFT, (0.036, 0.047, 0.037)),
    HandKey(92, _PUSH_LEFT, (0.036, 0.047, 0.037)),
    HandKey(97, _PUSH_LEFT, (0.058, 0.047, 0.042)),
    HandKey(104, _POINT, (0.115, 0.038, 0.042)),
    HandKey(111, _POINT, (0.115, 0.038, 0.0215)),
    HandKey(113, _POINT, (0.115, 0.038, 0.0215)),
    HandKey(120, _POINT, (0.124, 0.060, 0.066)),
)


def add_hands(context: bpy.types.Context) -> tuple[bpy.types.Object, ...]:
    """Add both hands as clay hands, with keyframes.

    Args:
        context: Its scene already contains the clay.

    Returns:
        The meshes of the right and the left hand.
    """
    hands = []
    for side, keys, color in (
        ("right", _RIGHT, (0.10, 0.22, 0.30)),
        ("left", _LEFT, (0.42, 0.10, 0.08)),
    ):
        item = add_hand(context, side, length=HAND_LENGTH)
        item.tactile_clay.collider_friction = _FRICTION
        armature = hand_armature(item)
        armature.show_in_front = False
        key_hand(armature, side, keys, length=HAND_LENGTH)
        add_sleeve(armature, item.name, color, length=HAND_LENGTH)
        hands.append(item)
    context.scene.frame_set(context.scene.frame_current)
    return tuple(hands)
