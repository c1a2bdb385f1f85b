# SPDX-License-Identifier: GPL-3.0-or-later
"""The two hands of the potter's wheel scene, and what they do: a pot is thrown in 8 seconds.

The potter sits at +Y. Both palms centre the lump; the left hand's fingers open it while the right
hand holds it together; then the fingers of both, one inside and one outside, squeeze the wall and
rise with it, twice.
"""

from __future__ import annotations

from dataclasses import replace

import bpy

from ..solver.hand_shape import POSES
from .add_hand import add_hand
from .hand_keys import HandHold, HandKey, add_sleeve, key_hand
from .hand_reading import hand_armature

HAND_LENGTH = 0.19
"""From wrist to fingertip [m]."""
LAST_FRAME = 265
PEDAL = ((1, 0.0), (20, 100.0), (234, 100.0), (260, 0.0))
"""Frames, and the wheel's speed [rpm] there."""
_FRICTION = 0.03
"""Coulomb friction coefficient of wet hands."""

_CUPPED = replace(
    POSES["flat"],
    index=(-2.0, 8.0, 10.0, 6.0),
    middle=(0.0, 8.0, 10.0, 6.0),
    ring=(2.0, 8.0, 10.0, 6.0),
    little=(5.0, 8.0, 10.0, 6.0),
    thumb=(-6.0, 10.0, 0.0, 10.0, 8.0),
)
_PALM = ("middle_proximal", "ring_proximal")
_CUP_RIGHT = HandHold(_CUPPED, (0.10, -1.0, -0.20), (-1.0, 0.0, 0.0), _PALM)
_CUP_LEFT = HandHold(_CUPPED, (-0.10, -1.0, -0.20), (1.0, 0.0, 0.0), _PALM)

_FINGER = replace(
    POSES["point"],
    index=(0.0, 8.0, 6.0, 4.0),
    middle=(0.0, 66.0, 84.0, 36.0),
    thumb=(10.0, 4.0, 30.0, 20.0, 20.0),
)
_INSIDE = HandHold(_FINGER, (-0.05, -0.15, -0.99), (1.0, -0.2, 0.0), ("index_tip",))
_FINGERS = replace(
    POSES["flat"],
    index=(-1.0, 10.0, 8.0, 4.0),
    middle=(0.0, 10.0, 8.0, 4.0),
    ring=(2.0, 12.0, 10.0, 5.0),
    little=(5.0, 20.0, 20.0, 10.0),
    thumb=(-6.0, 10.0, 0.0, 10.0, 8.0),
)
_OUTSIDE = HandHold(_FINGERS, (0.10, -0.50, -0.86), (-1.0, 0.0, -0.1), ("index_tip", "middle_tip"))

_RIGHT = (
    HandKey(1, _CUP_RIGHT, (-0.13, 0.0, 0.08)),
    HandKey(22, _CUP_RIGHT, (-0.084, 0.0, 0.036)),
    HandKey(56, _CUP_RIGHT, (-0.0715, 0.0, 0.036)),
    HandKey(62, _CUP_RIGHT, (-0.0715, 0.0, 0.036)),
    HandKey(68, _CUP_RIGHT, (-0.0760, 0.0, 0.036)),
    HandKey(130, _CUP_RIGHT, (-0.0760, 0.0, 0.037)),
    HandKey(215, _CUP_RIGHT, (-0.0760, 0.0, 0.040)),
    HandKey(222, _CUP_RIGHT, (-0.0760, 0.0, 0.040)),
    HandKey(230, _CUP_RIGHT, (-0.092, 0.0, 0.048)),
    HandKey(265, _CUP_RIGHT, (-0.20, 0.08, 0.14)),
)
_LEFT = (
    HandKey(1, _CUP_LEFT, (0.13, 0.0, 0.08)),
    HandKey(22, _CUP_LEFT, (0.084, 0.0, 0.036)),
    HandKey(56, _CUP_LEFT, (0.0715, 0.0, 0.036)),
    HandKey(62, _CUP_LEFT, (0.0715, 0.0, 0.036)),
    HandKey(70, _CUP_LEFT, (0.125, 0.01, 0.060)),
    HandKey(80, _INSIDE, (0.040, 0.02, 0.130)),
    HandKey(88, _INSIDE, (0.0, 0.0, 0.066)),
    HandKey(130, _INSIDE, (0.0, 0.0, 0.021)),
    HandKey(215, _INSIDE, (-0.028, 0.0, 0.021)),
    HandKey(222, _INSIDE, (-0.028, 0.0, 0.021)),
    HandKey(232, _INSIDE, (-0.010, 0.0, 0.060)),
    HandKey(242, _INSIDE, (0.0, 0.01, 0.130)),
    HandKey(265, _INSIDE, (0.14, 0.10, 0.20)),
)


def add_hands(context: bpy.types.Context) -> tuple[bpy.types.Object, ...]:
    """Add both hands, bound for the scene's clay and keyed.

    Args:
        context: Its scene has the clay already.

    Returns:
        The right and the left hand's mesh.
    """
    hands = []
    for side, keys in (("right", _RIGHT), ("left", _LEFT)):
        item = add_hand(context, side, length=HAND_LENGTH)
        item.tactile_clay.collider_friction = _FRICTION
        armature = hand_armature(item)
        armature.show_in_front = False
        key_hand(armature, side, keys, length=HAND_LENGTH)
        add_sleeve(armature, item.name, (0.10, 0.16, 0.22), length=HAND_LENGTH)
        hands.append(item)
    context.scene.frame_set(context.scene.frame_current)
    return tuple(hands)
