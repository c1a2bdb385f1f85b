# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand: a watertight mesh generated from 26 joints, their radii and a pose.

The joints are those of OpenXR's XR_EXT_hand_tracking. Forward kinematics places them from joint
angles; a smooth union of round cones and ellipsoids around them is the hand's signed distance; a
surface net, relaxed along that surface and projected back onto it, is the mesh. Fingers join the
palm smoothly and each other sharply, so that they never grow together.

Lengths of the bones follow Buryanov and Kotiuk, "Proportions of Hand Segments", International
Journal of Morphology 28(3), 2010; breadths are rounded averages of adult hands.

Frame: the wrist joint is the origin, straight fingers point to +Y, the back of the hand to +Z, and
the thumb of a right hand to -X.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "JOINT_NAMES",
    "POSES",
    "HandPose",
    "HandShape",
    "hand_mesh",
    "hand_mesh_in_poses",
    "hand_shape",
]

Array = NDArray[np.float64]

_FINGERS = ("index", "middle", "ring", "little")
_SEGMENTS = ("metacarpal", "proximal", "intermediate", "distal", "tip")

JOINT_NAMES: tuple[str, ...] = (
    "palm",
    "wrist",
    "thumb_metacarpal",
    "thumb_proximal",
    "thumb_distal",
    "thumb_tip",
    *(f"{finger}_{segment}" for finger in _FINGERS for segment in _SEGMENTS),
)
"""The joints of XrHandJointEXT, in its order."""

_REFERENCE_LENGTH = 0.19


class _Finger(NamedTuple):
    """One finger of the reference hand [m]."""

    carpal: tuple[float, float, float]
    """Base of the metacarpal."""
    knuckle: tuple[float, float, float]
    """Head of the metacarpal, where the finger bends."""
    lengths: tuple[float, float, float]
    """Proximal and intermediate bone, then the distal bone with the pad before it."""
    radii: tuple[float, float, float, float, float]
    """At the metacarpal's base, the knuckle, the two finger joints and the tip."""


_REFERENCE_FINGERS: Mapping[str, _Finger] = MappingProxyType(
    {
        "index": _Finger(
            (-0.0140, 0.0290, 0.0010),
            (-0.0275, 0.0955, 0.0030),
            (0.0398, 0.0224, 0.0197),
            (0.0120, 0.0112, 0.0091, 0.0081, 0.0070),
        ),
        "middle": _Finger(
            (-0.0040, 0.0330, 0.0030),
            (-0.0070, 0.0976, 0.0055),
            (0.0446, 0.0263, 0.0214),
            (0.0125, 0.0115, 0.0094, 0.0083, 0.0072),
        ),
        "ring": _Finger(
            (0.0065, 0.0330, 0.0015),
            (0.0125, 0.0910, 0.0035),
            (0.0414, 0.0257, 0.0213),
            (0.0122, 0.0109, 0.0088, 0.0078, 0.0068),
        ),
        "little": _Finger(
            (0.0165, 0.0300, -0.0020),
            (0.0295, 0.0820, -0.0015),
            (0.0327, 0.0181, 0.0197),
            (0.0115, 0.0100, 0.0079, 0.0070, 0.0061),
        ),
    }
)

_THUMB_BASE = (-0.0190, 0.0200, -0.0100)
_THUMB_DIRECTION = (-0.64, 0.70, -0.32)
_THUMB_NAIL = (-0.62, -0.28, 0.73)
_THUMB_LENGTHS = (0.0462, 0.0316, 0.0273)
_THUMB_RADII = (0.0150, 0.0125, 0.0110, 0.0086)


@dataclass(frozen=True)
class HandPose:
    """Joint angles of a hand [degrees].

    Flexion bends towards the palm; spread turns a finger sideways, away from the middle finger
    for the index (negative) and for the ring and little finger (positive).
    """

    index: tuple[float, float, float, float] = (-5.0, 0.0, 0.0, 0.0)
    """Spread of the finger, then flexion of its knuckle and its two finger joints."""
    middle: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """As for the index finger."""
    ring: tuple[float, float, float, float] = (5.0, 0.0, 0.0, 0.0)
    """As for the index finger."""
    little: tuple[float, float, float, float] = (12.0, 0.0, 0.0, 0.0)
    """As for the index finger."""
    thumb: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """At its base: flexion across the palm, lift out of the palm's plane and roll towards the
    fingers; then flexion of its two joints."""


POSES: Mapping[str, HandPose] = MappingProxyType(
    {
        "flat": HandPose(
            index=(-5.0, 0.0, 2.0, 2.0),
            middle=(0.0, 0.0, 2.0, 2.0),
            ring=(5.0, 0.0, 2.0, 2.0),
            little=(12.0, 0.0, 2.0, 2.0),
            thumb=(0.0, 0.0, 0.0, 8.0, 4.0),
        ),
        "relaxed": HandPose(
            index=(-4.0, 20.0, 26.0, 14.0),
            middle=(0.0, 25.0, 30.0, 16.0),
            ring=(4.0, 29.0, 33.0, 18.0),
            little=(9.0, 32.0, 34.0, 18.0),
            thumb=(10.0, 10.0, 10.0, 14.0, 18.0),
        ),
        "point": HandPose(
            index=(-2.0, 6.0, 6.0, 4.0),
            middle=(0.0, 74.0, 90.0, 38.0),
            ring=(2.0, 77.0, 90.0, 38.0),
            little=(4.0, 77.0, 84.0, 36.0),
            thumb=(28.0, -2.0, 46.0, 26.0, 30.0),
        ),
        "pinch": HandPose(
            index=(-6.0, 31.0, 59.0, 33.0),
            middle=(1.0, 26.0, 34.0, 20.0),
            ring=(4.0, 20.0, 28.0, 18.0),
            little=(9.0, 14.0, 24.0, 16.0),
            thumb=(23.0, 15.0, 57.0, 0.0, 1.0),
        ),
    }
)
"""Named poses: "flat", "relaxed", "point" (index extended, the others curled) and "pinch"
(thumb and index nearly touching)."""


@dataclass(frozen=True)
class HandShape:
    """Where a hand's joints are, and how far the skin is from each of them."""

    joints: Mapping[str, Array]
    """Position of each joint [m], shape [3], by the names in JOINT_NAMES."""
    radii: Mapping[str, float]
    """Radius of each joint [m], by the same names."""
    axes: Mapping[str, Array]
    """Axes of each joint as columns, shape [3, 3]: Y towards the tip, Z out of the hand's back."""


def hand_shape(
    side: str = "right", *, length: float = _REFERENCE_LENGTH, pose: str | HandPose = "flat"
) -> HandShape:
    """Place the 26 joints of a hand.

    Args:
        side: "right" or "left".
        length: From the wrist joint to the tip of the straight middle finger [m].
        pose: A name in POSES, or joint angles of one's own.

    Raises:
        ValueError: If the side or the pose is unknown, or the length is not positive.
    """
    factor = _scale(side, length)
    shape = _reference_shape(_named_pose(pose))
    mirror = np.sign(factor)
    return HandShape(
        {name: position * factor for name, position in shape.joints.items()},
        {name: radius * factor[1] for name, radius in shape.radii.items()},
        {name: mirror[:, None] * axes * mirror for name, axes in shape.axes.items()},
    )


def hand_mesh(
    side: str = "right",
    *,
    length: float = _REFERENCE_LENGTH,
    pose: str | HandPose = "flat",
    edge_length: float | None = None,
) -> tuple[Array, NDArray[np.int32]]:
    """Mesh a hand as one closed body.

    Args:
        side: "right" or "left"; the left hand is the mirror image in X.
        length: From the wrist joint to the tip of the straight middle finger [m].
        pose: A name in POSES, or joint angles of one's own.
        edge_length: Typical edge of a triangle [m]; by default 2.4 % of the hand's length.

    Returns:
        Vertices [m], shape [V, 3], and triangles that wind counter-clockwise seen from outside,
        shape [F, 3].

    Raises:
        ValueError: If the side or the pose is unknown, the length is not positive, or the edge
            is too long to tell the fingers apart.
    """
    factor = _scale(side, length)
    edge = 0.024 * _REFERENCE_LENGTH if edge_length is None else edge_length / factor[1]
    if not 0.001 <= edge <= 0.006:
        raise ValueError(
            f"edge_length must be between {0.001 * factor[1]:.4f} and {0.006 * factor[1]:.4f} m "
            f"for a hand of {length} m, not {edge_length}."
        )
    shape = _reference_shape(_named_pose(pose))
    corners = np.array(list(shape.joints.values()))
    vertices, faces = _surface_net(
        partial(_distance, shape=shape), corners.min(axis=0), corners.max(axis=0), edge
    )
    if factor[0] < 0.0:
        faces = faces[:, ::-1]
    return vertices * factor, np.ascontiguousarray(faces)


def hand_mesh_in_poses(
    poses: Sequence[str | HandPose],
    side: str = "right",
    *,
    length: float = _REFERENCE_LENGTH,
    edge_length: float | None = None,
) -> tuple[list[Array], NDArray[np.int32]]:
    """Mesh a hand once and bend that mesh into each of several poses.

    The mesh is made in the first pose; it follows the bones into the others and is laid onto the
    skin there. It keeps its triangles, so the poses can be mixed, for example as shape keys.

    Args:
        poses: Names in POSES, or joint angles; not too far apart, or skin folds at the knuckles.
        side: As for `hand_mesh`.
        length: As for `hand_mesh` [m].
        edge_length: As for `hand_mesh` [m].

    Returns:
        The vertices in each pose [m], shape [V, 3], and the triangles of all, shape [F, 3].

    Raises:
        ValueError: As for `hand_mesh`, or there is no pose.
    """
    if not poses:
        raise ValueError("Give at least one pose.")
    factor = _scale(side, length)
    vertices, faces = hand_mesh(side, length=length, pose=poses[0], edge_length=edge_length)
    first = _reference_shape(_named_pose(poses[0]))
    rest = vertices / factor
    bones, weights = _bone_weights(rest, first)
    result = [vertices]
    for pose in poses[1:]:
        shape = _reference_shape(_named_pose(pose))
        bent = np.zeros_like(rest)
        for bone, weight in zip(bones, weights.T, strict=True):
            turn = shape.axes[bone] @ first.axes[bone].T
            moved = (rest - first.joints[bone]) @ turn.T + shape.joints[bone]
            bent += weight[:, None] * moved
        for _ in range(3):
            bent = bent + _to_surface(partial(_distance, shape=shape), bent, 0.003)
        result.append(bent * factor)
    return result, faces


def _bone_weights(points: Array, shape: HandShape) -> tuple[list[str], Array]:
    """Tell how much each bone carries each point of the skin, shape [N, bones]."""
    bones = ["wrist"]
    nearness = [np.full(len(points), 3.0**-8)]
    for finger in ("thumb", *_FINGERS):
        chain = [joint for joint in shape.joints if joint.startswith(finger)]
        for start, end in pairwise(chain):
            axis = shape.joints[end] - shape.joints[start]
            offset = points - shape.joints[start]
            along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
            way = np.linalg.norm(offset - along[:, None] * axis, axis=1)
            radius = shape.radii[start] + along * (shape.radii[end] - shape.radii[start])
            bones.append(start)
            nearness.append(np.minimum((radius / np.maximum(way, 1e-6)) ** 8, 1e3))
    weights = np.stack(nearness, axis=1)
    return bones, weights / weights.sum(axis=1, keepdims=True)


def _scale(side: str, length: float) -> Array:
    """Return the factors that turn the reference hand into the one asked for, shape [3]."""
    if side not in ("right", "left"):
        raise ValueError(f'side must be "right" or "left", not {side!r}.')
    if not (np.isfinite(length) and length > 0.0):
        raise ValueError(f"length must be a positive number of metres, not {length!r}.")
    factor = length / _REFERENCE_LENGTH
    return np.array([factor if side == "right" else -factor, factor, factor])


def _named_pose(pose: str | HandPose) -> HandPose:
    if isinstance(pose, HandPose):
        return pose
    if pose not in POSES:
        raise ValueError(f"There is no pose {pose!r}; the poses are {', '.join(POSES)}.")
    return POSES[pose]


def _rotation(axis: int, degrees: float) -> Array:
    """Rotate about one axis, counter-clockwise seen from its tip."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[first, first] = matrix[second, second] = cosine
    matrix[second, first], matrix[first, second] = sine, -sine
    return matrix


def _frame(forward: Array, up: Array) -> Array:
    """Build axes whose Y is forward and whose Z is as near to up as that allows."""
    forward = forward / np.linalg.norm(forward)
    up = up - forward * (up @ forward)
    up = up / np.linalg.norm(up)
    return np.stack([np.cross(forward, up), forward, up], axis=1)


def _reference_shape(pose: HandPose) -> HandShape:
    """Place the joints of the right reference hand."""
    joints: dict[str, Array] = {"palm": np.array([-0.003, 0.064, 0.0]), "wrist": np.zeros(3)}
    radii: dict[str, float] = {"palm": 0.0140, "wrist": 0.0185}
    frames: dict[str, Array] = {"palm": np.eye(3), "wrist": np.eye(3)}

    flexion, lift, roll, *bends = pose.thumb
    axes = _frame(np.array(_THUMB_DIRECTION), np.array(_THUMB_NAIL))
    axes = axes @ _rotation(2, -lift) @ _rotation(0, -flexion) @ _rotation(1, -roll)
    place = np.array(_THUMB_BASE)
    segments = ("metacarpal", "proximal", "distal", "tip")
    tip_inset = (0.0, 0.0, _THUMB_RADII[-1])
    joints["thumb_metacarpal"], radii["thumb_metacarpal"] = place, _THUMB_RADII[0]
    frames["thumb_metacarpal"] = axes
    for number, bone in enumerate(_THUMB_LENGTHS):
        place = place + axes[:, 1] * (bone - tip_inset[number])
        joints[f"thumb_{segments[number + 1]}"] = place
        radii[f"thumb_{segments[number + 1]}"] = _THUMB_RADII[number + 1]
        if number < 2:
            axes = axes @ _rotation(0, -bends[number])
        frames[f"thumb_{segments[number + 1]}"] = axes

    for name, finger in _REFERENCE_FINGERS.items():
        spread, *bends = getattr(pose, name)
        place = np.array(finger.knuckle)
        joints[f"{name}_metacarpal"], joints[f"{name}_proximal"] = np.array(finger.carpal), place
        frames[f"{name}_metacarpal"] = _frame(
            place - joints[f"{name}_metacarpal"], np.array([0.0, 0.0, 1.0])
        )
        axes = _rotation(2, -spread)
        for number, bone in enumerate(finger.lengths):
            axes = axes @ _rotation(0, -bends[number])
            frames[f"{name}_{_SEGMENTS[number + 1]}"] = axes
            place = place + axes[:, 1] * (bone - (finger.radii[-1] if number == 2 else 0.0))
            joints[f"{name}_{_SEGMENTS[number + 2]}"] = place
        frames[f"{name}_tip"] = axes
        for segment, radius in zip(_SEGMENTS, finger.radii, strict=True):
            radii[f"{name}_{segment}"] = radius
    return HandShape(
        {name: joints[name] for name in JOINT_NAMES},
        {name: radii[name] for name in JOINT_NAMES},
        {name: frames[name] for name in JOINT_NAMES},
    )


def _cone(points: Array, start: Array, end: Array, first: float, second: float) -> Array:
    """Signed distance to the hull of two balls [m], shape [N]."""
    axis = end - start
    length = float(np.linalg.norm(axis))
    slope = float(np.clip((first - second) / length, -0.999, 0.999))
    rise = float(np.sqrt(1.0 - slope * slope))
    offset = points - start
    along = offset @ (axis / length)
    across = np.sqrt(np.maximum((offset * offset).sum(axis=1) - along * along, 0.0))
    seat = along - across * (slope / rise)
    side = across * rise + along * slope - first
    at_start = np.hypot(along, across) - first
    at_end = np.hypot(along - length, across) - second
    return np.where(seat < 0.0, at_start, np.where(seat > length, at_end, side))


def _ellipsoid(points: Array, center: Array, axes: Array, radii: tuple[float, ...]) -> Array:
    """Signed distance to an ellipsoid [m], shape [N]: exact on its surface, close near it."""
    local = (points - center) @ axes
    scaled = np.linalg.norm(local / radii, axis=1)
    slope = np.maximum(np.linalg.norm(local / np.square(radii), axis=1), 1e-9)
    return scaled * (scaled - 1.0) / slope


def _blend(first: Array, second: Array, width: float | Array) -> Array:
    """Union of two distances with a fillet of the given width [m], shape [N]."""
    overlap = np.maximum(width - np.abs(first - second), 0.0)
    return np.minimum(first, second) - overlap * overlap * (0.25 / width)


def _distance(points: Array, shape: HandShape) -> Array:
    """Signed distance to the skin of the reference hand [m], shape [N]."""
    palm = _palm_distance(points, shape)
    distance = palm
    for name in ("thumb", *_FINGERS):
        finger = _finger_distance(points, shape, name)
        # Only the root of a finger runs into the palm: a fingertip that touches it stays apart.
        knuckle = f"{name}_proximal"
        way = np.linalg.norm(points - shape.joints[knuckle], axis=1) / shape.radii[knuckle]
        distance = np.minimum(distance, _blend(palm, finger, 0.005 * np.clip(3 - way, 0.05, 1)))
    return distance


def _palm_distance(points: Array, shape: HandShape) -> Array:
    """Signed distance to palm, web, ball of the thumb and wrist [m], shape [N]."""
    joints, radii, axes = shape.joints, shape.radii, shape.axes
    distance = _cone(
        points, np.array([-0.0095, 0.034, -0.001]), np.array([-0.0090, -0.06, 0.0]), 0.0165, 0.0185
    )
    ulnar = _cone(
        points, np.array([0.0125, 0.030, -0.003]), np.array([0.0100, -0.06, 0.0]), 0.0150, 0.0180
    )
    distance = _blend(distance, ulnar, 0.012)
    for name in _FINGERS:
        base, knuckle = f"{name}_metacarpal", f"{name}_proximal"
        bone = _cone(points, joints[base], joints[knuckle], radii[base], radii[knuckle])
        distance = _blend(distance, bone, 0.010)
        forward = joints[f"{name}_intermediate"] - joints[knuckle]
        web = joints[knuckle] + 0.22 * forward - 0.002 * axes[knuckle][:, 2]
        root = _cone(points, joints[knuckle], web, radii[knuckle], 0.92 * radii[knuckle])
        distance = _blend(distance, root, 0.008)

    start, end = joints["thumb_metacarpal"], joints["thumb_proximal"]
    bone = _cone(points, start, end, radii["thumb_metacarpal"], radii["thumb_proximal"])
    distance = _blend(distance, bone, 0.012)
    ball = 0.58 * start + 0.42 * end + np.array([0.010, 0.002, -0.004])
    thenar = _ellipsoid(
        points, ball, _frame(end - start, np.array([0.0, 0.0, 1.0])), (0.0155, 0.0245, 0.0150)
    )
    distance = _blend(distance, thenar, 0.012)
    index = joints["index_metacarpal"] * 0.45 + joints["index_proximal"] * 0.55
    fold = _cone(points, 0.35 * start + 0.65 * end, index, 0.0085, 0.0090)
    distance = _blend(distance, fold, 0.016)
    hypothenar = _ellipsoid(
        points, np.array([0.0245, 0.045, -0.0095]), np.eye(3), (0.0135, 0.0330, 0.0125)
    )
    distance = _blend(distance, hypothenar, 0.012)
    cut = -0.034 - points[:, 1]
    return -_blend(-distance, -cut, 0.006)


def _finger_distance(points: Array, shape: HandShape, name: str) -> Array:
    """Signed distance to one finger beyond its knuckle [m], shape [N]."""
    joints, radii, axes = shape.joints, shape.radii, shape.axes
    chain = [joint for joint in joints if joint.startswith(name)][1:]
    distance = np.full(len(points), 1.0)
    for start, end in pairwise(chain):
        bone = _cone(points, joints[start], joints[end], radii[start], radii[end])
        distance = _blend(distance, bone, 0.002)
        middle = 0.45 * joints[start] + 0.55 * joints[end]
        girth = 0.5 * (radii[start] + radii[end])
        pad = _ellipsoid(
            points,
            middle - 0.17 * girth * axes[start][:, 2],
            axes[start],
            (0.86 * girth, 0.46 * float(np.linalg.norm(joints[end] - joints[start])), 0.90 * girth),
        )
        distance = _blend(distance, pad, 0.004)
    return distance


def _sample(
    distance: Callable[[Array], Array], low: Array, high: Array, cell: float
) -> tuple[Array, Array]:
    """Sample a signed distance on a grid, well only near zero; return its origin and values [m]."""
    block = 4
    low = low - 0.045
    blocks = np.ceil((high + 0.045 - low) / (block * cell)).astype(int)
    where = np.indices(blocks.tolist()).reshape(3, -1).T
    center = distance(low + cell * block * (where + 0.5))
    values = np.repeat(center, block**3).reshape(-1, block, block, block)
    # A signed distance changes by no more than the way gone; the margin is for the ellipsoids'.
    near = np.abs(center) < 1.3 * cell * block * 0.5 * np.sqrt(3.0)
    offsets = np.indices((block,) * 3).reshape(3, -1).T
    points = low + cell * ((where[near] * block)[:, None, :] + offsets + 0.5)
    values[near] = distance(points.reshape(-1, 3)).reshape(-1, block, block, block)
    values = values.reshape(*blocks, block, block, block).transpose(0, 3, 1, 4, 2, 5)
    return low + 0.5 * cell, values.reshape(blocks * block)


_CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners of a grid cell; corner (i, j, k) has the number 4 i + 2 j + k."""


def _connected(corners: set[int]) -> bool:
    """Whether one can walk between all these corners of a cell along its edges."""
    reached: set[int] = set()
    ahead = set(list(corners)[:1])
    while ahead:
        reached |= ahead
        ahead = {corner ^ bit for corner in ahead for bit in (1, 2, 4)} & corners - reached
    return reached == corners


def _one_sheet() -> NDArray[np.bool_]:
    """Tell for each pattern of inside corners whether one sheet of surface cuts it, shape [256]."""
    inside = [{corner for corner in range(8) if pattern >> corner & 1} for pattern in range(256)]
    return np.array([_connected(part) and _connected(set(range(8)) - part) for part in inside])


def _patterns(values: Array) -> NDArray[np.uint8]:
    """Number the pattern of inside corners of every cell, shape [X - 1, Y - 1, Z - 1]."""
    shape = np.array(values.shape) - 1
    pattern = np.zeros(shape, dtype=np.uint8)
    for number, (i, j, k) in enumerate(_CORNERS):
        part = values[i : shape[0] + i, j : shape[1] + j, k : shape[2] + k] < 0.0
        pattern |= part.astype(np.uint8) << np.uint8(number)
    return pattern


def _open_creases(values: Array) -> NDArray[np.uint8]:
    """Part skin that touches skin, in place, until no cell is cut by two sheets of surface.

    Each such cell loses its shallowest inside corner; so the net closes and fingers that touch
    stay apart. Returns the patterns of inside corners.
    """
    one_sheet = _one_sheet()
    pattern = _patterns(values)
    while True:
        cells = np.argwhere(~one_sheet[pattern])
        if len(cells) == 0:
            return pattern
        corners = cells[:, None, :] + _CORNERS
        depth = values[tuple(corners.reshape(-1, 3).T)].reshape(-1, 8)
        shallowest = np.where(depth < 0.0, depth, -np.inf).argmax(axis=1)
        values[tuple(corners[np.arange(len(cells)), shallowest].T)] = 1e-9
        pattern = _patterns(values)


def _surface_net(
    distance: Callable[[Array], Array], low: Array, high: Array, edge: float
) -> tuple[Array, NDArray[np.int32]]:
    """Mesh the zero level of a signed distance inside a box around some of its points."""
    # A quad of the net is cut into two triangles: their mean edge is 1.1 of the cell's.
    cell = edge / 1.1
    origin, values = _sample(distance, low, high, cell)
    pattern = _open_creases(values)
    inside = values < 0.0
    cut = (pattern > 0) & (pattern < 255)
    number = np.full(cut.shape, -1, dtype=np.int32)
    number[cut] = np.arange(np.count_nonzero(cut), dtype=np.int32)
    vertices = origin + cell * (np.argwhere(cut) + 0.5)

    quads = []
    for axis in range(3):
        _, second, third = np.roll(np.eye(3, dtype=int), -axis, axis=0)
        ahead = np.roll(inside, -1, axis=axis)
        for enters in (False, True):
            where = np.argwhere((inside != ahead) & (ahead == enters))
            around = [where - a * second - b * third for a, b in ((1, 1), (0, 1), (0, 0), (1, 0))]
            quad = np.stack([number[tuple(cells.T)] for cells in around], axis=1)
            quads.append(quad[:, ::-1] if enters else quad)
    net = np.concatenate(quads)
    vertices = _relax(vertices, net, distance, cell)
    return vertices, _triangles(vertices, net)


def _edges(net: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.concatenate([net[:, [i, (i + 1) % 4]] for i in range(4)])


def _relax(
    vertices: Array, net: NDArray[np.int32], distance: Callable[[Array], Array], cell: float
) -> Array:
    """Move a net onto the surface and even out its quads along it, shape [V, 3]."""
    edges = _edges(net)
    neighbour_count = np.bincount(edges[:, 0], minlength=len(vertices))[:, None]
    for sweep in range(9):
        if 0 < sweep < 8:
            sums = [
                np.bincount(edges[:, 0], vertices[edges[:, 1], axis], minlength=len(vertices))
                for axis in range(3)
            ]
            vertices = vertices + 0.6 * (np.stack(sums, axis=1) / neighbour_count - vertices)
        vertices = vertices + _to_surface(distance, vertices, cell)
    return vertices


def _to_surface(distance: Callable[[Array], Array], points: Array, farthest: float) -> Array:
    """Way from points to the surface near them, no longer than `farthest` [m], shape [N, 3]."""
    probe = np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]]) * 2e-4
    values = distance((points[:, None, :] + probe).reshape(-1, 3)).reshape(-1, 4)
    slope = values @ probe / (4.0 * 2e-4**2)
    square = np.maximum(np.sum(slope * slope, axis=1), 0.04)
    return -slope * np.clip(values.mean(axis=1) / square, -farthest, farthest)[:, None]


def _triangles(vertices: Array, net: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cut each quad along its shorter diagonal, shape [F, 3]."""
    first = np.linalg.norm(vertices[net[:, 0]] - vertices[net[:, 2]], axis=1)
    second = np.linalg.norm(vertices[net[:, 1]] - vertices[net[:, 3]], axis=1)
    net = np.where((first <= second)[:, None], net, np.roll(net, -1, axis=1))
    return np.concatenate([net[:, [0, 1, 2]], net[:, [0, 2, 3]]]).astype(np.int32)
