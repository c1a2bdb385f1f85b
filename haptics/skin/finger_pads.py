# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a hand's finger pads are, from the names of its bones and the shape of its skin."""

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
"""How bones of a finger are called: in OpenXR, WebXR, Rigify, Mixamo, VRM, MMD and by hand."""
_RIGHT = re.compile(r"(^|[^a-z])(r|right)([^a-z]|$)|右|right")
_LEFT = re.compile(r"(^|[^a-z])(l|left)([^a-z]|$)|左|left")

_MAX_JOINTS = 7
"""A finger of more joints than this is none that is known here."""
_TIP_PART = 0.7
"""The last joint is a tip, inside the pad, if the skin ends within this part of the last bone."""
_PAD_BEGINS = 0.2
"""Where the pad begins, from the last joint to the skin's end."""
_PAD_COSINE = 0.5
"""Skin of the pad faces the palm's side within 60°."""

Real = NDArray[np.float64]


@dataclass(frozen=True)
class FingerPads:
    """The pads of a hand."""

    vertices: NDArray[np.bool_]
    """Whether each vertex of the skin belongs to a pad, shape [V]."""
    fingers: tuple[str, ...]
    """Fingers whose pads were found."""
    finger_length: float
    """Mean length of the fingers between the knuckle and the last joint [m]."""


def find_finger_pads(rig: HandRig) -> FingerPads:
    """Find the pads of every finger that a hand has.

    A finger's bones are known by their names and ordered away from the hand; the last joint, or
    the one before where the last lies in the tip, begins the last segment. Its skin is what its
    bones carry most; the pad is the part of it that faces the palm's side. Which side that is
    follows from the knuckles of index and little finger and whether the hand is a left or a right
    one, or from where the thumb lies where that is not known; bending carries it along the fingers.

    Raises:
        ValueError: No finger is found; the message says which names are understood.
    """
    heads = rig.bone_rest[:, :3, 3]
    chains = _chains(rig, heads)
    if not chains:
        raise ValueError(
            "No finger was found among the bones "
            f"{', '.join(rig.bone_names[:6])}, … Their names must hold thumb, index, middle, ring "
            "or little (or pinky), with two bones or more to a finger."
        )
    normals = _vertex_normals(rig.vertices, rig.faces)
    owner = _vertex_bones(rig)
    ahead, palm, across = _hand_frame(rig, heads, chains)
    found = np.zeros(len(rig.vertices), bool)
    fingers, lengths = [], []
    for name, chain in chains.items():
        last, direction, length = _last_segment(rig, heads, owner, chain)
        if name == "thumb":
            # A thumb lies turned on its side: its pad faces the fingers as much as the palm's side.
            facing = palm + across
        else:
            facing = _turned(palm, ahead, direction)
            joints = heads[chain[: chain.index(last) + 1]]
            lengths.append(float(np.linalg.norm(np.diff(joints[-3:], axis=0), axis=1).sum()))
        facing = facing - direction * (facing @ direction)
        facing /= np.linalg.norm(facing)
        carried = np.isin(owner, chain[chain.index(last) :])
        along = (rig.vertices - heads[last]) @ direction
        pad = carried & (along > _PAD_BEGINS * length) & (normals @ facing > _PAD_COSINE)
        if pad.any():
            found |= pad
            fingers.append(name)
    if not fingers:
        raise ValueError(
            "The fingers' last bones carry no skin on the palm's side: bind the hand with weights "
            "for its fingers, in a pose where it is open."
        )
    length = float(np.mean(lengths)) if lengths else 0.35 * float(np.ptp(rig.vertices, 0).max())
    return FingerPads(found, tuple(fingers), length)


def _chains(rig: HandRig, heads: Real) -> dict[str, list[int]]:
    """Bones of each finger, from the hand outward; fingers of one bone are left out."""
    # A body's skeleton has two hands.
    other = {"left": "right", "right": "left"}.get(rig.side, "-")
    own = [i for i, name in enumerate(rig.bone_names) if _named_side(name) != other]
    named = {
        finger: [i for i in own if re.search(pattern, rig.bone_names[i].lower())]
        for finger, pattern in _NAMES.items()
    }
    root = _wrist(rig, heads, {bone for bones in named.values() for bone in bones})
    chains = {}
    for finger, bones in named.items():
        apart: list[int] = []
        # Bones in one place are one joint here, as control bones beside deforming ones are.
        for bone in bones:
            if all(np.linalg.norm(heads[bone] - heads[other]) > 1e-4 for other in apart):
                apart.append(bone)
        if 2 <= len(apart) <= _MAX_JOINTS:
            chains[finger] = _along_finger(heads, apart, root)
    return chains


def _along_finger(heads: Real, bones: list[int], root: Real) -> list[int]:
    """The bones in the order of the shortest way through all of them, outward.

    Imported hands often have bones without parents, so only places count.
    """
    places = heads[bones]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    ways = (way for way in permutations(range(len(bones))) if way[0] < way[-1])
    best = min(ways, key=lambda way: sum(apart[i, j] for i, j in pairwise(way)))
    inner, outer = (np.linalg.norm(places[best[end]] - root) for end in (0, -1))
    return [bones[i] for i in (best if inner <= outer else reversed(best))]


def _last_segment(
    rig: HandRig, heads: Real, owner: NDArray[np.intp], chain: list[int]
) -> tuple[int, Real, float]:
    """Joint that a finger's last segment begins with, where it points, and its length [m]."""
    direction = heads[chain[-1]] - heads[chain[-2]]
    bone = float(np.linalg.norm(direction))
    direction = direction / bone
    skin = rig.vertices[np.isin(owner, chain[-2:])]
    # Skin off the finger's axis does not say where the finger ends.
    offset = skin - heads[chain[-1]]
    beside = np.linalg.norm(offset - np.outer(offset @ direction, direction), axis=1)
    ahead = (offset @ direction)[beside < max(bone, 1e-3)]
    end = float(ahead.max(initial=0.0))
    if len(chain) > 2 and end < _TIP_PART * bone:
        return chain[-2], direction, bone + end
    return chain[-1], direction, end


def _hand_frame(rig: HandRig, heads: Real, chains: dict[str, list[int]]) -> tuple[Real, Real, Real]:
    """Unit vectors: along the fingers, out of the palm, and from the thumb's side across."""
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
    """Place in a finger's chain of the joint where it leaves the palm, as far as one can tell."""
    return 1 if len(chain) >= 5 else 0


def _wrist(rig: HandRig, heads: Real, fingers: set[int]) -> Real:
    """A point on the arm's side of the knuckles."""
    other = {"left": "right", "right": "left"}.get(rig.side, "-")
    for pattern in (r"wrist|手首", r"hand"):
        for index, name in enumerate(rig.bone_names):
            if index in fingers or _named_side(name) == other:
                continue
            if re.search(pattern, name.lower()):
                return np.asarray(heads[index])
    others = [i for i in range(len(heads)) if i not in fingers]
    return np.asarray(heads[others or slice(None)].mean(0))


def _side(rig: HandRig) -> str:
    """Whether a hand is a left or a right one, empty where it is not known."""
    if rig.side:
        return rig.side
    sides = [_named_side(name) for name in rig.bone_names]
    right, left = sides.count("right"), sides.count("left")
    return "" if right == left else "right" if right > left else "left"


def _named_side(name: str) -> str:
    """The side that a bone's name tells, empty where it tells none."""
    words = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()
    right, left = bool(_RIGHT.search(words)), bool(_LEFT.search(words))
    return "" if right == left else "right" if right else "left"


def _turned(vector: Real, start: Real, end: Real) -> Real:
    """A vector turned by the least rotation that brings one unit vector to another."""
    axis = np.cross(start, end)
    cosine = float(start @ end)
    if cosine < -0.999:
        return -vector
    return np.asarray(
        vector * cosine + np.cross(axis, vector) + axis * (axis @ vector) / (1.0 + cosine)
    )


def _vertex_bones(rig: HandRig) -> NDArray[np.intp]:
    """The bone that carries each vertex of the skin most, shape [V]."""
    corners = rig.tetrahedra[rig.vertex_tetrahedron]
    share = rig.vertex_weights[:, :, None] * rig.node_weights[corners]
    total = np.zeros((len(rig.vertices), len(rig.bone_names)))
    rows = np.arange(len(rig.vertices))[:, None, None]
    np.add.at(total, (rows, rig.node_bones[corners]), share)
    return total.argmax(1)


def _vertex_normals(vertices: Real, faces: NDArray[np.integer]) -> Real:
    """Unit normals, of the faces about each vertex by their areas, shape [V, 3]."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for column in range(3):
        np.add.at(total, faces[:, column], normal)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))
