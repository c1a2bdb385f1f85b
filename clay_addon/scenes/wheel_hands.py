# SPDX-License-Identifier: GPL-3.0-or-later
"""The two hands of the potter's wheel scene, which throw a pot in 8 seconds.

The potter sits at +Y. Both palms center the lump; then the two index fingers open it and move
apart, so that its wall rises. The hands mirror each other, so nothing pushes the clay off the axis.
"""

from __future__ import annotations

from dataclasses import replace

import bpy

from ...solver.hand.shape import POSES
from ..hands.add_hand import add_hand
from ..hands.reading import hand_armature
from .hand_keys import HandHold, HandKey, add_sleeve, key_hand

HAND_LENGTH = 0.19
"""From wrist to fingertip [m]."""
LAST_FRAME = 240
WHEEL_SPEEDS = ((1, 0.0), (20, 100.0), (206, 100.0), (236, 0.0))
"""Frames, and the wheel's speed at each [rpm]."""
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
    thumb=(14.0, 4.0, 30.0, 30.0, 30.0),
)
_OPEN_RIGHT = HandHold(_FINGER, (0.22, -0.10, -0.97), (0.0, -1.0, 0.1), ("index_tip",))
_OPEN_LEFT = HandHold(_FINGER, (-0.22, -0.10, -0.97), (0.0, -1.0, 0.1), ("index_tip",))


def _both(
    frame: int, right: HandHold, left: HandHold, place: tuple[float, float, float]
) -> tuple[HandKey, HandKey]:
    """Keys of both hands, mirrored across x = 0.

    Args:
        frame: Frame of the keys.
        right: Hold of the right hand.
        left: Hold of the left hand.
        place: Location of the left hand's anchor [m].
    """
    x, y, z = place
    return HandKey(frame, right, (-x, y, z)), HandKey(frame, left, (x, y, z))


_KEYS = (
    # Both hands approach and center the lump.
    _both(1, _CUP_RIGHT, _CUP_LEFT, (0.130, 0.0, 0.080)),
    _both(22, _CUP_RIGHT, _CUP_LEFT, (0.084, 0.0, 0.036)),
    _both(56, _CUP_RIGHT, _CUP_LEFT, (0.0715, 0.0, 0.036)),
    _both(62, _CUP_RIGHT, _CUP_LEFT, (0.0715, 0.0, 0.036)),
    _both(70, _CUP_RIGHT, _CUP_LEFT, (0.120, 0.0, 0.060)),
    # Two fingers open it and move apart.
    _both(78, _OPEN_RIGHT, _OPEN_LEFT, (0.050, 0.0, 0.120)),
    _both(86, _OPEN_RIGHT, _OPEN_LEFT, (0.010, 0.0, 0.068)),
    _both(140, _OPEN_RIGHT, _OPEN_LEFT, (0.009, 0.0, 0.022)),
    _both(186, _OPEN_RIGHT, _OPEN_LEFT, (0.0165, 0.0, 0.022)),
    _both(192, _OPEN_RIGHT, _OPEN_LEFT, (0.0165, 0.0, 0.022)),
    _both(206, _OPEN_RIGHT, _OPEN_LEFT, (0.012, 0.0, 0.100)),
    _both(240, _OPEN_RIGHT, _OPEN_LEFT, (0.150, 0.08, 0.160)),
)


def add_hands(context: bpy.types.Context) -> tuple[bpy.types.Object, ...]:
    """Add both hands as clay hands, with keyframes.

    Args:
        context: Its scene already contains the clay.

    Returns:
        The meshes of the right and the left hand.
    """
    hands = []
    for side, keys in zip(("right", "left"), zip(*_KEYS, strict=True), strict=True):
        item = add_hand(context, side, length=HAND_LENGTH)
        item.tactile_clay.collider_friction = _FRICTION
        armature = hand_armature(item)
        armature.show_in_front = False
        key_hand(armature, side, keys, length=HAND_LENGTH)
        add_sleeve(armature, item.name, (0.10, 0.16, 0.22), length=HAND_LENGTH)
        hands.append(item)
    context.scene.frame_set(context.scene.frame_current)
    return tuple(hands)
