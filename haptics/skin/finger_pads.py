# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the finger pads of a hand from the names of its bones and the shape of its skin."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from ...solver.hand.bone_names import FINGER_WORDS
from ...solver.hand.proportions import FINGERS
from ...solver.hand.rig import HandRig

_FINGERS = ("thumb", *FINGERS)
_OTHER_WORDS = {
    "thumb": r"pollex|親指",
    "index": r"point|fore(?!arm)|人指|人差",
    "middle": r"中指",
    "ring": r"薬指",
    "little": r"pink|small|小指",
}
"""What else bones of a finger are called: in MMD, in Latin and by hand."""
_NAMES = {
    finger: "|".join(
        [word for word, place in FINGER_WORDS.items() if place == index] + [_OTHER_WORDS[finger]]
    )
    for index, finger in enumerate(_FINGERS)
}
"""Finger names in bone names: of OpenXR, WebXR, Rigify, Mixamo, VRM, MMD and common usage."""
_RIGHT = re.compile(r"(^|[^a-z])(r|right)([^a-z]|$)|右|right")
_LEFT = re.compile(r"(^|[^a-z])(l|left)([^a-z]|$)|左|left")

_MAX_JOINTS = 7
"""A chain with more joints than this is not taken for a finger."""
_TIP_FRACTION = 0.7
"""The last joint is a tip inside the pad if the skin ends within this fraction of the last bone."""
_PAD_START = 0.2
"""Where the pad starts, as a fraction of the way from the last joint to the end of the skin."""
_PAD_COSINE = 0.5
"""The skin of a pad faces the palm side within 60°."""

Real = NDArray[np.float64]


@dataclass(frozen=True)
class FingerPads:
    """The finger pads of a hand."""

    vertices: NDArray[np.bool_]
    """Whether each vertex of the skin belongs to a pad, shape [V]."""
    fingers: tuple[str, ...]
    """Names of the fingers whose pads were found."""
    finger_length: float
    """Mean length of the fingers from the knuckle to the last joint [m]."""


def find_finger_pads(rig: HandRig) -> FingerPads:
    """Find the pads of all fingers of a hand.

    The bones of a finger are identified by name and ordered from the hand outward. The last segment
    starts at the last joint, or at the one before if the last joint is in the fingertip. Its skin
    is the vertices that its bones carry most; the pad is the part that faces the palm side. That
    side follows from the knuckles of the index and little fingers and from whether the hand is left
    or right, or from the thumb if that is unknown. It is rotated along with the bent fingers.

    Raises:
        ValueError: No finger was found; the message says which bone names are understood.
    """
    heads = rig.bone_rest[:, :3, 3]
    chains = _chains(rig, heads)
    if not chains:
        raise ValueError(
            "No finger was found among the bones "
            f"{', '.join(rig.bone_names[:6])}, … Their names must contain thumb, index, middle, "
            "ring or little (or pinky), and each finger needs at least two bones."
        )
    normals = _vertex_normals(rig.vertices, rig.faces)
    owner = _vertex_bones(rig)
    ahead, palm, across = _hand_frame(rig, heads, chains)
    found = np.zeros(len(rig.vertices), bool)
    fingers, lengths = [], []
    for name, chain in chains.items():
        last, direction, length = _last_segment(rig, heads, owner, chain)
        if name == "thumb":
            # A thumb is rotated: its pad faces the fingers as much as the palm side.
            facing = palm + across
        else:
            facing = _turned(palm, ahead, direction)
            joints = heads[chain[: chain.index(last) + 1]]
            lengths.append(float(np.linalg.norm(np.diff(joints[-3:], axis=0), axis=1).sum()))
        facing = facing - direction * (facing @ direction)
        facing /= np.linalg.norm(facing)
        carried = np.isin(owner, chain[chain.index(last) :])
        along = (rig.vertices - heads[last]) @ direction
        pad = carried & (along > _PAD_START * length) & (normals @ facing > _PAD_COSINE)
        if pad.any():
            found |= pad
            fingers.append(name)
    if not fingers:
        raise ValueError(
            "The last bones of the fingers carry no skin on the palm side. Bind the hand with "
            "weights for its fingers, in an open pose."
        )
    length = float(np.mean(lengths)) if lengths else 0.35 * float(np.ptp(rig.vertices, 0).max())
    return FingerPads(found, tuple(fingers), length)


def _chains(rig: HandRig, heads: Real) -> dict[str, list[int]]:
    """Bones of each finger, from the hand outward; fingers with a single bone are left out."""
    # The skeleton of a body has two hands.
    other_side = {"left": "right", "right": "left"}.get(rig.side, "-")
    own = [i for i, name in enumerate(rig.bone_names) if _named_side(name) != other_side]
    named = {
        finger: [i for i in own if re.search(pattern, rig.bone_names[i].lower())]
        for finger, pattern in _NAMES.items()
    }
    root = _wrist(rig, heads, {bone for bones in named.values() for bone in bones})
    chains = {}
    for finger, bones in named.items():
        joints: list[int] = []
        # Several bones at the same point, such as a control bone and a deform bone, are one joint.
        for bone in bones:
            if all(np.linalg.norm(heads[bone] - heads[joint]) > 1e-4 for joint in joints):
                joints.append(bone)
        if 2 <= len(joints) <= _MAX_JOINTS:
            chains[finger] = _along_finger(heads, joints, root)
    return chains


def _along_finger(heads: Real, bones: list[int], root: Real) -> list[int]:
    """Order bones along the shortest path through all of them, from the hand outward.

    Uses only positions, because bones of imported hands often have no parents.
    """
    places = heads[bones]
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    paths = (path for path in permutations(range(len(bones))) if path[0] < path[-1])
    best = min(paths, key=lambda path: sum(distance[i, j] for i, j in pairwise(path)))
    inner, outer = (np.linalg.norm(places[best[end]] - root) for end in (0, -1))
    return [bones[i] for i in (best if inner <= outer else reversed(best))]


def _last_segment(
    rig: HandRig, heads: Real, owner: NDArray[np.intp], chain: list[int]
) -> tuple[int, Real, float]:
    """First joint of a finger's last segment, its direction, and its length [m]."""
    direction = heads[chain[-1]] - heads[chain[-2]]
    bone = float(np.linalg.norm(direction))
    direction = direction / bone
    skin = rig.vertices[np.isin(owner, chain[-2:])]
    # Only skin near the finger's axis shows where the finger ends.
    offset = skin - heads[chain[-1]]
    off_axis = np.linalg.norm(offset - np.outer(offset @ direction, direction), axis=1)
    ahead = (offset @ direction)[off_axis < max(bone, 1e-3)]
    end = float(ahead.max(initial=0.0))
    if len(chain) > 2 and end < _TIP_FRACTION * bone:
        return chain[-2], direction, bone + end
    return chain[-1], direction, end


def _hand_frame(rig: HandRig, heads: Real, chains: dict[str, list[int]]) -> tuple[Real, Real, Real]:
    """Unit vectors: along the fingers, out of the palm, and across it, away from the thumb."""
    straight = [chain for name, chain in chains.items() if name != "thumb"]
    if len(straight) >= 2:
        knuckles = [heads[chain[_knuckle(chain)]] for chain in straight]
        across = knuckles[-1] - knuckles[0]
        bones = {bone for chain in chains.values() for bone in chain}
        ahead = np.mean(knuckles, axis=0) - _wrist(rig, heads, bones)
    else:
        only = straight[0] if straight else chains["thumb"]
        ahead = heads[only[1]] - heads[only[0]]
        across = np.cross(ahead, rig.bone_rest[only[0]][:3, 2])
    across = across - ahead * (across @ ahead) / (ahead @ ahead)
    across, ahead = across / np.linalg.norm(across), ahead / np.linalg.norm(ahead)
    palm = np.cross(across, ahead)
    side = _side(rig)
    if side == "right":
        palm = -palm
    elif side == "" and "thumb" in chains:
        tip = heads[chains["thumb"][-1]] - heads[[c[0] for c in chains.values()]].mean(0)
        palm = palm if tip @ palm > 0.0 else -palm
    return ahead, palm, across


def _knuckle(chain: list[int]) -> int:
    """Index of the knuckle in the chain of a finger: a chain of five includes the metacarpal."""
    return 1 if len(chain) >= 5 else 0


def _wrist(rig: HandRig, heads: Real, fingers: set[int]) -> Real:
    """A point on the arm side of the knuckles."""
    other_side = {"left": "right", "right": "left"}.get(rig.side, "-")
    for pattern in (r"wrist|手首", r"hand"):
        for index, name in enumerate(rig.bone_names):
            if index in fingers or _named_side(name) == other_side:
                continue
            if re.search(pattern, name.lower()):
                return np.asarray(heads[index])
    others = [i for i in range(len(heads)) if i not in fingers]
    return np.asarray(heads[others or slice(None)].mean(0))


def _side(rig: HandRig) -> str:
    """``left`` or ``right``, or an empty string if unknown."""
    if rig.side:
        return rig.side
    sides = [_named_side(name) for name in rig.bone_names]
    right, left = sides.count("right"), sides.count("left")
    return "" if right == left else "right" if right > left else "left"


def _named_side(name: str) -> str:
    """The side named in a bone name, or an empty string."""
    words = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()
    right, left = bool(_RIGHT.search(words)), bool(_LEFT.search(words))
    return "" if right == left else "right" if right else "left"


def _turned(vector: Real, start: Real, end: Real) -> Real:
    """Rotate a vector by the smallest rotation that takes one unit vector to another."""
    axis = np.cross(start, end)
    cosine = float(start @ end)
    if cosine < -0.999:
        return -vector
    return np.asarray(
        vector * cosine + np.cross(axis, vector) + axis * (axis @ vector) / (1.0 + cosine)
    )


def _vertex_bones(rig: HandRig) -> NDArray[np.intp]:
    """The bone with the largest weight at each vertex of the skin, shape [V]."""
    corners = rig.tetrahedra[rig.vertex_tetrahedron]
    share = rig.vertex_weights[:, :, None] * rig.node_weights[corners]
    total = np.zeros((len(rig.vertices), len(rig.bone_names)))
    rows = np.arange(len(rig.vertices))[:, None, None]
    np.add.at(total, (rows, rig.node_bones[corners]), share)
    return total.argmax(1)


def _vertex_normals(vertices: Real, faces: NDArray[np.integer]) -> Real:
    """Unit normals of vertices, weighted by face area, shape [V, 3]."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for column in range(3):
        np.add.at(total, faces[:, column], normal)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))
