# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand with its skeleton, in any size.

Bones are OpenXR's 26 joints (XR_EXT_hand_tracking). Each has its origin at the joint, -Z along the
bone towards the fingertip, +Y out of the back of the hand and +X to the right. Trackers use the
same axes, so a tracked joint's pose, converted from Y up to Z up, is the bone's matrix.

The frame is that of `hand_shape`: wrist at the origin, fingers along +Y, back of the hand to +Z.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .mesh import hand_mesh
from .proportions import AVERAGE, FINGERS, REFERENCE_LENGTH, SEGMENTS, HandProportions
from .rig import MAX_BONES
from .shape import HandPose, HandShape, hand_shape, reference_shape
from .skinned_hand import SkinnedHand
from .weights import BONE_NAMES, bone_parents, bone_weights

if TYPE_CHECKING:
    from .rig import HandRig

REST_POSE = HandPose(
    index=(-7.0, 8.0, 10.0, 6.0),
    middle=(0.0, 8.0, 10.0, 6.0),
    ring=(7.0, 8.0, 10.0, 6.0),
    little=(15.0, 8.0, 10.0, 6.0),
    thumb=(4.0, 6.0, 6.0, 10.0, 10.0),
)
"""Fingers spread and slightly bent, between a flat hand and a fist."""

_GAP = 0.0025
"""Gap between fingers at rest, in a hand of the reference length [m]."""
_WEB = 0.6
"""Fingers are separate beyond this point, in lengths of the proximal bone from the knuckle."""
_SMOOTHING = 6
_NEGLIGIBLE = 0.02
"""Weights below this are dropped, so that fingers do not pull on each other."""


def default_hand(
    side: str = "right",
    *,
    length: float = REFERENCE_LENGTH,
    proportions: HandProportions = AVERAGE,
    edge_length: float | None = None,
) -> SkinnedHand:
    """Make the default hand in its rest pose.

    Args:
        side: "right" or "left".
        length: From the wrist joint to the tip of the straight middle finger [m].
        proportions: Sizes of the hand's parts relative to each other.
        edge_length: Typical edge of a triangle [m]; by default 2.4 % of the hand's length.

    Returns:
        The hand, with a watertight skin and at most four bones per vertex.

    Raises:
        ValueError: The side is unknown, the length is not positive, or the edge is too long to
            resolve the gaps between fingers.
    """
    pose = rest_pose(proportions)
    vertices, faces = hand_mesh(
        side, length=length, pose=pose, edge_length=edge_length, proportions=proportions
    )
    shape = hand_shape(side, length=length, pose=pose, proportions=proportions)
    weights = _smoothed(bone_weights(vertices, shape), faces)
    return SkinnedHand(
        side=side,
        vertices=vertices,
        faces=faces,
        bone_names=BONE_NAMES,
        bone_rest=np.stack(list(bone_matrices(shape).values())),
        bone_parent=bone_parents(),
        weights=weights,
    )


def default_hand_rig(
    side: str = "right",
    *,
    clay_spacing: float,
    length: float = REFERENCE_LENGTH,
    proportions: HandProportions = AVERAGE,
) -> HandRig:
    """Make the default hand and bind it for clay.

    Args:
        side: As for `default_hand`.
        clay_spacing: Distance between neighboring clay particles [m].
        length: As for `default_hand` [m].
        proportions: As for `default_hand`.

    Raises:
        ValueError: As for `default_hand` and `bind_hand`.
    """
    from .binding import bind_hand

    hand = default_hand(side, length=length, proportions=proportions)
    return bind_hand(hand, clay_spacing=clay_spacing)


def rest_pose(proportions: HandProportions) -> HandPose:
    """The rest pose for given proportions: `REST_POSE`, with thick fingers spread further."""
    for share in np.arange(1.0, 3.0, 0.1):
        pose = replace(
            REST_POSE,
            **{
                name: (share * getattr(REST_POSE, name)[0], *getattr(REST_POSE, name)[1:])
                for name in FINGERS
            },
        )
        if _narrowest_gap(reference_shape(pose, proportions)) > _GAP:
            break
    return pose


def _narrowest_gap(shape: HandShape) -> float:
    """Narrowest gap between neighboring fingers beyond their webs [m]."""
    share = np.linspace(_WEB, 3.0, 25)
    tubes = []
    for name in FINGERS:
        chain = [f"{name}_{segment}" for segment in SEGMENTS[1:]]
        joints = np.array([shape.joints[joint] for joint in chain])
        radii = [shape.radii[joint] for joint in chain]
        axis = np.stack([np.interp(share, range(4), values) for values in joints.T], axis=1)
        tubes.append((axis, np.interp(share, range(4), radii)))
    gaps = [
        np.linalg.norm(first[0][:, None] - second[0], axis=2) - first[1][:, None] - second[1]
        for first, second in pairwise(tubes)
    ]
    return float(np.min(gaps))


def bone_matrices(shape: HandShape) -> dict[str, NDArray[np.float64]]:
    """Matrix of each bone in a pose, bone to world, by bone name, shape [4, 4]."""
    matrices = {}
    for name in BONE_NAMES:
        matrix = np.eye(4)
        right, ahead, up = shape.axes[name].T
        matrix[:3] = np.column_stack([right, up, -ahead, shape.joints[name]])
        matrices[name] = matrix
    return matrices


def _smoothed(weights: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Smooth weights along the skin and keep the largest; rows sum to one, shape [V, B]."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    degree = np.bincount(edges[:, 0], minlength=len(weights))[:, None]
    for _ in range(_SMOOTHING):
        sums = np.zeros_like(weights)
        np.add.at(sums, edges[:, 0], weights[edges[:, 1]])
        weights = 0.5 * weights + 0.5 * sums / degree
    threshold = -np.sort(-weights, axis=1)[:, MAX_BONES - 1 : MAX_BONES]
    weights = np.where(weights >= np.maximum(threshold, _NEGLIGIBLE), weights, 0.0)
    return weights / weights.sum(1, keepdims=True)
