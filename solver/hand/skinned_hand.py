# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed skin carried by bones (linear blend skinning): a hand before it is bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, kw_only=True)
class SkinnedHand:
    """A skin and its skeleton in the rest pose. Lengths in meters, in world coordinates.

    Raises:
        ValueError: Arrays do not fit each other.
    """

    side: str = ""
    """Which hand: left or right, or empty if unknown."""
    vertices: NDArray[np.float64]
    """Skin, shape [V, 3]."""
    faces: NDArray[np.int32]
    """Triangles, wound outward, shape [F, 3]."""
    bone_names: tuple[str, ...]
    """Names of the B bones."""
    bone_rest: NDArray[np.float64]
    """World from each bone's own coordinates, shape [B, 4, 4]."""
    bone_parent: NDArray[np.int32]
    """Index of each bone's parent, -1 for a root, shape [B], in any order."""
    weights: NDArray[np.float64]
    """How strongly each bone carries each vertex, shape [V, B]; rows need not add up to one."""

    def __post_init__(self) -> None:
        bones, vertices = len(self.bone_names), len(self.vertices)
        expected = {
            "vertices": (vertices, 3),
            "faces": (len(self.faces), 3),
            "bone_rest": (bones, 4, 4),
            "bone_parent": (bones,),
            "weights": (vertices, bones),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"SkinnedHand.{name} has shape {getattr(self, name).shape}; expected {shape}."
                )

    def posed(self, bones: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Skin positions for given bone poses (linear blend skinning) [m], shape [V, 3].

        Args:
            bones: World from each bone's own coordinates, by bone name, shape [4, 4]; bones not
                named stay at rest.
        """
        posed = np.zeros_like(self.vertices)
        share = self.weights / self.weights.sum(1, keepdims=True)
        for index, name in enumerate(self.bone_names):
            turn = np.eye(4)
            if name in bones:
                turn = np.asarray(bones[name], np.float64) @ np.linalg.inv(self.bone_rest[index])
            moved = self.vertices @ turn[:3, :3].T + turn[:3, 3]
            posed += share[:, index, None] * moved
        return posed
