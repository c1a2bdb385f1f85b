# SPDX-License-Identifier: GPL-3.0-or-later
"""The two hands of the kindergarten scene, and what they do in two seconds.

First the right hand lies down flat on the red block, while the left pinches the head off the
caterpillar. Then both push the yellow and the blue block together, and last the left index finger
presses a dent into the violet block.

Both are default hands: ordinary armatures, of which every bone and the whole are keyed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ..solver.default_hand import bone_matrices
from ..solver.hand_shape import POSES, HandPose, hand_shape
from .add_hand import add_hand
from .hand_reading import hand_armature
from .kindergarten_parts import Vec3, mesh_object, plain_material

HAND_LENGTH = 0.15
"""From wrist to fingertip of a child of nine [m]."""
_FRICTION = 0.8
"""Coulomb friction coefficient of a child's hands, which are not clean."""


@dataclass(frozen=True)
class _Hold:
    """How a hand is held."""

    pose: HandPose
    forward: Vec3
    """Where straight fingers point."""
    back: Vec3
    """Where the back of the hand looks."""
    anchor: tuple[str, ...]
    """The joints whose middle goes along the path."""


@dataclass(frozen=True)
class _Key:
    """Where a hand is at a frame, and how it is held."""

    frame: int
    hold: _Hold
    place: Vec3
    """Of the anchor [m]."""


_FLAT = _Hold(
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
_PINCHED = _Hold(
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
_PUSH_RIGHT = _Hold(_PUSH_POSE, (0.05, -1.0, -0.16), (-1.0, 0.0, 0.0), _PUSH_ANCHOR)
_PUSH_LEFT = _Hold(_PUSH_POSE, (-0.05, -1.0, -0.16), (1.0, 0.0, 0.0), _PUSH_ANCHOR)
_POINT = _Hold(POSES["point"], (-0.15, -0.80, -0.55), (0.0, 0.0, 1.0), ("index_tip",))

_RIGHT = (
    _Key(1, _FLAT, (-0.106, 0.036, 0.075)),
    _Key(8, _FLAT, (-0.106, 0.014, 0.056)),
    _Key(38, _FLAT, (-0.106, 0.010, 0.0255)),
    _Key(46, _FLAT, (-0.106, 0.010, 0.0255)),
    _Key(56, _FLAT, (-0.104, 0.040, 0.075)),
    _Key(68, _PUSH_RIGHT, (-0.058, 0.047, 0.037)),
    _Key(88, _PUSH_RIGHT, (-0.036, 0.047, 0.037)),
    _Key(92, _PUSH_RIGHT, (-0.036, 0.047, 0.037)),
    _Key(99, _PUSH_RIGHT, (-0.058, 0.047, 0.040)),
    _Key(120, _PUSH_RIGHT, (-0.110, 0.130, 0.090)),
)
_LEFT = (
    _Key(1, _OPEN, (0.092, -0.030, 0.050)),
    _Key(10, _OPEN, (0.085, -0.050, 0.0125)),
    _Key(24, _PINCHED, (0.085, -0.050, 0.0090)),
    _Key(42, _PINCHED, (0.138, -0.050, 0.022)),
    _Key(48, _OPEN, (0.140, -0.050, 0.025)),
    _Key(57, _OPEN, (0.120, -0.010, 0.075)),
    _Key(68, _PUSH_LEFT, (0.058, 0.047, 0.037)),
    _Key(88, _PUSH_LEFT, (0.036, 0.047, 0.037)),
    _Key(92, _PUSH_LEFT, (0.036, 0.047, 0.037)),
    _Key(97, _PUSH_LEFT, (0.058, 0.047, 0.042)),
    _Key(104, _POINT, (0.115, 0.038, 0.042)),
    _Key(111, _POINT, (0.115, 0.038, 0.0215)),
    _Key(113, _POINT, (0.115, 0.038, 0.0215)),
    _Key(120, _POINT, (0.124, 0.060, 0.066)),
)


def add_hands(context: bpy.types.Context) -> tuple[bpy.types.Object, ...]:
    """Add both hands, bound for the scene's clay and keyed.

    Args:
        context: Its scene has the clay already.

    Returns:
        The right and the left hand's mesh.
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
        _key(armature, side, keys)
        _add_sleeve(armature, item.name, color)
        hands.append(item)
    context.scene.frame_set(context.scene.frame_current)
    return tuple(hands)


def _key(armature: bpy.types.Object, side: str, keys: tuple[_Key, ...]) -> None:
    """Key the armature's transform and the turning of its bones."""
    armature.rotation_mode = "QUATERNION"
    for bone in armature.pose.bones:
        bone.rotation_mode = "QUATERNION"
    for key in keys:
        shape = hand_shape(side, length=HAND_LENGTH, pose=key.hold.pose)
        back = Vector(key.hold.back)
        forward = Vector(key.hold.forward).normalized()
        right = forward.cross(back).normalized()
        turn = Matrix((right, forward, right.cross(forward))).transposed()
        anchor = np.mean([shape.joints[name] for name in key.hold.anchor], axis=0)
        armature.location = Vector(key.place) - turn @ Vector(anchor.tolist())
        armature.rotation_quaternion = _nearer(turn.to_quaternion(), armature.rotation_quaternion)
        armature.keyframe_insert("location", frame=key.frame)
        armature.keyframe_insert("rotation_quaternion", frame=key.frame)
        posed = {name: Matrix(m.tolist()) for name, m in bone_matrices(shape).items()}
        for bone in armature.pose.bones:
            rest, place = bone.bone.matrix_local, posed[bone.name]
            if bone.parent:
                rest = bone.parent.bone.matrix_local.inverted() @ rest
                place = posed[bone.parent.name].inverted() @ place
            turned = (rest.inverted() @ place).to_quaternion()
            bone.rotation_quaternion = _nearer(turned, bone.rotation_quaternion)
            bone.keyframe_insert("rotation_quaternion", frame=key.frame)


def _nearer(turn: Quaternion, other: Quaternion) -> Quaternion:
    """Of the two quaternions of a rotation, the one from which it is not far to another."""
    return -turn if turn.dot(other) < 0.0 else turn


_CUFF = (
    (-0.034, 0.000), (-0.016, 0.001), (-0.012, 0.0035), (-0.015, 0.0065),
    (-0.034, 0.0075), (-0.039, 0.0055), (-0.044, 0.0060), (-0.120, 0.010), (-0.450, 0.018),
)  # fmt: skip
"""Profile of a sleeve: way along the arm, and distance to the wrist's skin [m]."""


def _add_sleeve(armature: bpy.types.Object, name: str, color: Vec3) -> None:
    """Dress the wrist; the sleeve goes with the hand and does not touch the clay."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rings = [
        np.stack(
            [(0.028 + gap) * np.cos(angle), np.full(24, way), (0.0185 + gap) * np.sin(angle)],
            axis=1,
        )
        for way, gap in _CUFF
    ]
    vertices = np.concatenate(rings) * (HAND_LENGTH / 0.19)
    faces = [
        (24 * ring + n, 24 * ring + (n + 1) % 24, 24 * ring + 24 + (n + 1) % 24, 24 * ring + 24 + n)
        for ring in range(len(rings) - 1)
        for n in range(24)
    ]
    sleeve = mesh_object(f"{name}, sleeve", vertices, faces)
    sleeve.data.shade_smooth()
    sleeve.modifiers.new("Soft", "SUBSURF").levels = 1
    sleeve.data.materials.append(plain_material(f"{name}, cloth", color, 0.9))
    sleeve.parent = armature
