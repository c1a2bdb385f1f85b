# SPDX-License-Identifier: GPL-3.0-or-later
"""Bone weights of the default hand's skin.

The weights of a point are divided among fingers by its distance to each finger, and within a finger
between the bones at a joint by its distance from the joint's bisecting plane.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .proportions import FINGERS, JOINT_NAMES
from .shape import HandShape

Array = NDArray[np.float64]

BONE_NAMES: tuple[str, ...] = ("wrist", "palm", *JOINT_NAMES[2:])
"""Bones, named after the joints at their heads; parents come before children."""

_SHARPNESS = 8
"""Exponent of the nearness: sharpness of the transition from one finger to the next."""
_WRIST_NEARNESS = 3.0**-_SHARPNESS
"""Skin farther than three radii from every finger follows the wrist."""
_CARPUS = {"thumb": (-0.3, 0.45), "finger": (-0.1, 0.55)}
"""Range of the transition from the wrist to a metacarpal, from its base in lengths of the bone."""
_BLEND = {"proximal": 1.25, "intermediate": 0.95, "distal": 0.85}
"""Half the width of the transition from one bone to the next, in radii of the joint."""
_CREASE = {"proximal": 0.55, "intermediate": 0.1, "distal": 0.1}
"""Shift of the transition towards the tip on the palm side, per distance from the axis."""


def bone_parents() -> NDArray[np.int32]:
    """Index of each bone's parent, -1 for the wrist, shape [26]."""
    parents = [-1, 0]
    for before, name in pairwise(BONE_NAMES[1:]):
        parents.append(0 if name.endswith("metacarpal") else BONE_NAMES.index(before))
    return np.array(parents, np.int32)


def bone_weights(points: Array, shape: HandShape) -> Array:
    """Bone weights of points on the skin, in the order of BONE_NAMES, shape [N, 26].

    Args:
        points: Points on the skin in the shape's pose [m], shape [N, 3].
        shape: Joints of a hand.
    """
    chains = {
        name: [joint for joint in JOINT_NAMES if joint.startswith(name)]
        for name in ("thumb", *FINGERS)
    }
    nearness = np.stack([_nearness(points, shape, chain) for chain in chains.values()], axis=1)
    total = nearness.sum(axis=1) + _WRIST_NEARNESS
    weights = np.zeros((len(points), len(BONE_NAMES)))
    weights[:, 0] = _WRIST_NEARNESS / total
    for chain, near in zip(chains.values(), nearness.T, strict=True):
        beyond = _beyond_wrist(points, shape, chain)
        weights[:, 0] += near / total * (1.0 - beyond)
        for index, joint in enumerate(chain[:-1]):
            following = (
                _beyond(points, shape, chain, index + 1)
                if index + 2 < len(chain)
                else np.zeros(len(points))
            )
            following = np.minimum(following, beyond)
            weights[:, BONE_NAMES.index(joint)] = near / total * (beyond - following)
            beyond = following
    return weights


def _nearness(points: Array, shape: HandShape, chain: list[str]) -> Array:
    """Nearness of points to a finger: an inverse power of their distance in radii, shape [N]."""
    nearest = np.full(len(points), np.inf)
    for start, end in pairwise(chain):
        axis = shape.joints[end] - shape.joints[start]
        offset = points - shape.joints[start]
        along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
        distance = np.linalg.norm(offset - along[:, None] * axis, axis=1)
        radius = shape.radii[start] + along * (shape.radii[end] - shape.radii[start])
        nearest = np.minimum(nearest, distance / radius)
    return np.minimum(np.maximum(nearest, 1e-3) ** -_SHARPNESS, 1e3)


def _beyond_wrist(points: Array, shape: HandShape, chain: list[str]) -> Array:
    """Weight of a metacarpal and the bones beyond it, relative to the wrist, shape [N]."""
    start, end = shape.joints[chain[0]], shape.joints[chain[1]]
    along = (points - start) @ (end - start) / ((end - start) @ (end - start))
    first, last = _CARPUS["thumb" if chain[0].startswith("thumb") else "finger"]
    return _step((along - first) / (last - first))


def _step(x: Array) -> Array:
    """Smoothstep: rises from 0 at 0 to 1 at 1."""
    share = np.clip(x, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _beyond(points: Array, shape: HandShape, chain: list[str], index: int) -> Array:
    """Weight of the bones beyond a joint: 0 before the joint, 1 after it, shape [N]."""
    joint, before = chain[index], chain[index - 1]
    ahead = shape.axes[joint][:, 1] + shape.axes[before][:, 1]
    up = shape.axes[joint][:, 2] + shape.axes[before][:, 2]
    offset = points - shape.joints[joint]
    segment = joint.split("_")[1]
    radius = shape.radii[joint]
    distance = offset @ (ahead / np.linalg.norm(ahead))
    depth = np.clip(-offset @ (up / np.linalg.norm(up)), -1.5 * radius, 1.5 * radius)
    distance = distance - _CREASE[segment] * depth
    return _step(0.5 + 0.5 * distance / (_BLEND[segment] * radius))
