# SPDX-License-Identifier: GPL-3.0-or-later
"""The two hands of the potter's wheel scene, and what they do: a pot is thrown in 16 seconds.

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
LAST_FRAME = 480
PEDAL = ((1, 0.0), (40, 100.0), (425, 100.0), (470, 0.0))
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
_PALM = ("middle_proximal", "ring_proximal", "middle_intermediate", "ring_intermediate")
_CUP_RIGHT = HandHold(_CUPPED, (0.10, -1.0, -0.20), (-1.0, 0.0, 0.0), _PALM)
_CUP_LEFT = HandHold(_CUPPED, (-0.10, -1.0, -0.20), (1.0, 0.0, 0.0), _PALM)

_TIPS = ("index_tip", "middle_tip")
_DIPPED = replace(
    POSES["flat"],
    index=(-1.0, 14.0, 10.0, 6.0),
    middle=(0.0, 12.0, 10.0, 6.0),
    ring=(2.0, 30.0, 36.0, 20.0),
    little=(5.0, 42.0, 48.0, 26.0),
    thumb=(-6.0, 10.0, 0.0, 10.0, 8.0),
)
_INSIDE = HandHold(_DIPPED, (-0.20, -0.45, -0.87), (1.0, 0.0, 0.2), _TIPS)
_OUTSIDE = HandHold(_DIPPED, (0.20, -0.60, -0.77), (-1.0, 0.0, -0.2), _TIPS)

_RIGHT = (
    HandKey(1, _CUP_RIGHT, (-0.13, 0.02, 0.09)),
    HandKey(30, _CUP_RIGHT, (-0.09, 0.0, 0.045)),
    HandKey(100, _CUP_RIGHT, (-0.062, 0.0, 0.045)),
    HandKey(170, _CUP_RIGHT, (-0.064, 0.0, 0.045)),
    HandKey(215, _CUP_RIGHT, (-0.070, 0.0, 0.042)),
    HandKey(225, _OUTSIDE, (-0.100, 0.0, 0.030)),
    HandKey(235, _OUTSIDE, (-0.068, 0.0, 0.016)),
    HandKey(310, _OUTSIDE, (-0.062, 0.0, 0.080)),
    HandKey(320, _OUTSIDE, (-0.090, 0.0, 0.080)),
    HandKey(330, _OUTSIDE, (-0.066, 0.0, 0.014)),
    HandKey(405, _OUTSIDE, (-0.060, 0.0, 0.100)),
    HandKey(425, _OUTSIDE, (-0.120, 0.05, 0.150)),
    HandKey(480, _OUTSIDE, (-0.20, 0.15, 0.20)),
)
_LEFT = (
    HandKey(1, _CUP_LEFT, (0.13, 0.02, 0.09)),
    HandKey(30, _CUP_LEFT, (0.09, 0.0, 0.045)),
    HandKey(100, _CUP_LEFT, (0.062, 0.0, 0.045)),
    HandKey(108, _CUP_LEFT, (0.085, 0.0, 0.060)),
    HandKey(122, _INSIDE, (0.0, 0.0, 0.110)),
    HandKey(130, _INSIDE, (0.0, 0.0, 0.085)),
    HandKey(170, _INSIDE, (0.0, 0.0, 0.020)),
    HandKey(215, _INSIDE, (-0.030, 0.0, 0.020)),
    HandKey(235, _INSIDE, (-0.034, 0.0, 0.020)),
    HandKey(310, _INSIDE, (-0.034, 0.0, 0.085)),
    HandKey(320, _INSIDE, (-0.020, 0.0, 0.080)),
    HandKey(330, _INSIDE, (-0.038, 0.0, 0.020)),
    HandKey(405, _INSIDE, (-0.036, 0.0, 0.105)),
    HandKey(420, _INSIDE, (-0.010, 0.02, 0.150)),
    HandKey(480, _INSIDE, (0.14, 0.15, 0.20)),
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
