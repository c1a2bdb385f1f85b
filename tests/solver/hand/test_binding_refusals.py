# SPDX-License-Identifier: GPL-3.0-or-later
"""Invalid input of binding, and its error messages."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_clay.solver.geometry.closed_mesh import MeshError
from tactile_clay.solver.hand.binding import bind_hand
from tactile_clay.solver.hand.default_hand import default_hand
from tactile_clay.solver.hand.skinned_hand import SkinnedHand


@pytest.fixture(scope="module")
def hand() -> SkinnedHand:
    return default_hand()


def with_hole(hand: SkinnedHand) -> SkinnedHand:
    return replace(hand, faces=hand.faces[np.setdiff1d(np.arange(len(hand.faces)), [10, 2000])])


def inside_out(hand: SkinnedHand) -> SkinnedHand:
    return replace(hand, faces=np.ascontiguousarray(hand.faces[:, ::-1]))


def with_watch(hand: SkinnedHand) -> SkinnedHand:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.01)
    ball.apply_translation((0.0, 0.0, 0.05))
    return replace(
        hand,
        vertices=np.concatenate([hand.vertices, ball.vertices]),
        faces=np.concatenate([hand.faces, ball.faces + len(hand.vertices)]).astype(np.int32),
        weights=np.concatenate([hand.weights, np.ones((len(ball.vertices), 26))]),
    )


def half_rigged(hand: SkinnedHand) -> SkinnedHand:
    weights = hand.weights.copy()
    weights[100:107] = 0.0
    return replace(hand, weights=weights)


def not_finite(hand: SkinnedHand) -> SkinnedHand:
    vertices = hand.vertices.copy()
    vertices[[5, 9], 1] = np.nan
    return replace(hand, vertices=vertices)


def bad_weights(hand: SkinnedHand) -> SkinnedHand:
    weights = hand.weights.copy()
    weights[3, 4] = -0.1
    return replace(hand, weights=weights)


def loose_vertex(hand: SkinnedHand) -> SkinnedHand:
    return replace(
        hand,
        vertices=np.concatenate([hand.vertices, [[0.0, 0.0, 1.0]]]),
        weights=np.concatenate([hand.weights, hand.weights[:1]]),
    )


@pytest.mark.parametrize(
    ("corrupt", "words"),
    [
        (with_hole, "open: it has 2 holes"),
        (inside_out, "inside out"),
        (with_watch, "2 separate pieces"),
        (half_rigged, "7 of 3828 vertices without bone weights"),
        (not_finite, "2 vertices that are not finite"),
        (bad_weights, "weights that are negative or not finite"),
        (loose_vertex, "1 vertices without a face"),
    ],
)
def test_invalid_skin_is_refused(hand: SkinnedHand, corrupt: Any, words: str) -> None:
    """Say what is wrong with the mesh, with numbers, and what to do."""
    with pytest.raises(MeshError, match=words):
        bind_hand(corrupt(hand), clay_spacing=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bone_names": ("wrist",) * 26}, "same name"),
        ({"bone_rest": np.zeros((26, 4, 4))}, "scale is zero"),
        ({"bone_parent": np.roll(np.arange(26), 1).astype(np.int32)}, "own ancestor"),
        ({"bone_parent": np.full(26, 99, np.int32)}, "does not exist"),
    ],
)
def test_invalid_bones_are_refused(hand: SkinnedHand, change: dict, words: str) -> None:
    """Say what is wrong with the skeleton."""
    with pytest.raises(ValueError, match=words):
        bind_hand(replace(hand, **change), clay_spacing=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"clay_spacing": 0.0}, "above 0"),
        ({"clay_spacing": float("nan")}, "above 0"),
        ({"clay_spacing": 1e-5}, "ghosts on this hand; check the units"),
        ({"clay_spacing": 0.1}, "too coarse for this hand"),
        ({"clay_spacing": 0.01, "cell": -1.0}, "above 0"),
        ({"clay_spacing": 0.01, "cell": 0.1}, "too coarse for a hand of this size"),
        ({"clay_spacing": 0.01, "cell": 1e-4}, "more than 100,000 nodes"),
    ],
)
def test_unsuitable_sizes_are_refused(hand: SkinnedHand, options: dict, words: str) -> None:
    """Say which sizes are allowed."""
    with pytest.raises(ValueError, match=words):
        bind_hand(hand, **options)
