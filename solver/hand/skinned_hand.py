# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed skin with bone weights (linear blend skinning): a hand before it is bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, kw_only=True)
class SkinnedHand:
    """A skin and its skeleton in the rest pose. Lengths in meters, in world coordinates.

    Raises:
        ValueError: The shapes of arrays are inconsistent.
    """

    side: str = ""
    """Which hand: left or right, or empty if unknown."""
    vertices: NDArray[np.float64]
    """Vertices of the skin, shape [V, 3]."""
    faces: NDArray[np.int32]
    """Triangles, wound outward, shape [F, 3]."""
    bone_names: tuple[str, ...]
    """Names of the B bones."""
    bone_rest: NDArray[np.float64]
    """Rest matrix of each bone, bone to world, shape [B, 4, 4]."""
    bone_parent: NDArray[np.int32]
    """Index of each bone's parent, -1 for a root, shape [B]; in any order."""
    weights: NDArray[np.float64]
    """Bone weights of each vertex, shape [V, B]; rows need not sum to one."""

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
        """Vertex positions for given bone poses (linear blend skinning) [m], shape [V, 3].

        Args:
            bones: Matrices of bones by name, bone to world, shape [4, 4]; other bones stay at rest.
        """
        posed = np.zeros_like(self.vertices)
        share = self.weights / self.weights.sum(1, keepdims=True)
        for index, name in enumerate(self.bone_names):
            matrix = np.eye(4)
            if name in bones:
                matrix = np.asarray(bones[name], np.float64) @ np.linalg.inv(self.bone_rest[index])
            moved = self.vertices @ matrix[:3, :3].T + matrix[:3, 3]
            posed += share[:, index, None] * moved
        return posed
