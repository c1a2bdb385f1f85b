# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyframed hands of the ready-made scenes, and their sleeves.

A `HandHold` is a pose of the fingers with an orientation of the hand; a `HandKey` places it at a
frame and location.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ...solver.hand.default_hand import bone_matrices
from ...solver.hand.proportions import REFERENCE_LENGTH
from ...solver.hand.shape import HandPose, hand_shape
from .parts import Vec3, mesh_object, plain_material


@dataclass(frozen=True)
class HandHold:
    """A finger pose and an orientation."""

    pose: HandPose
    forward: Vec3
    """Direction in which straight fingers point."""
    back: Vec3
    """Direction in which the back of the hand faces."""
    anchor: tuple[str, ...]
    """Joints whose centroid is the hand's location in a `HandKey`."""


@dataclass(frozen=True)
class HandKey:
    """How a hand is held at a frame, and where."""

    frame: int
    hold: HandHold
    place: Vec3
    """Location of the anchor [m]."""


def key_hand(
    armature: bpy.types.Object, side: str, keys: Sequence[HandKey], *, length: float
) -> None:
    """Insert keyframes for an armature's transform and the rotation of its bones.

    Args:
        armature: Armature of a default hand.
        side: "right" or "left".
        keys: The keys, in order of frames.
        length: Length with which the hand was added [m].
    """
    armature.rotation_mode = "QUATERNION"
    for bone in armature.pose.bones:
        bone.rotation_mode = "QUATERNION"
    for key in keys:
        shape = hand_shape(side, length=length, pose=key.hold.pose)
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
    """Of the two quaternions of a rotation, the one closer to another."""
    return -turn if turn.dot(other) < 0.0 else turn


_CUFF = (
    (-0.034, 0.000), (-0.016, 0.001), (-0.012, 0.0035), (-0.015, 0.0065),
    (-0.034, 0.0075), (-0.039, 0.0055), (-0.044, 0.0060), (-0.120, 0.010), (-0.450, 0.018),
)  # fmt: skip
"""Profile of a sleeve: position along the arm, and distance from the wrist's skin [m]."""


def add_sleeve(armature: bpy.types.Object, name: str, color: Vec3, *, length: float) -> None:
    """Add a sleeve, which moves with the hand and does not touch the clay.

    Args:
        armature: Armature of a default hand.
        name: Name of the hand.
        color: Linear RGB of the cloth.
        length: Length with which the hand was added [m].
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rings = [
        np.stack(
            [(0.028 + gap) * np.cos(angle), np.full(24, way), (0.0185 + gap) * np.sin(angle)],
            axis=1,
        )
        for way, gap in _CUFF
    ]
    vertices = np.concatenate(rings) * (length / REFERENCE_LENGTH)
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
