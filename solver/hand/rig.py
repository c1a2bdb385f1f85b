# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand bound for simulation: its skin, skeleton, tetrahedra and ghosts in the rest pose.

After section III-D of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: flesh is a tetrahedral mesh attached to bones, and ghost particles rasterized in the rest
pose are embedded in the tetrahedra around them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_BONES = 4
"""Largest number of bones that carry one node of the flesh."""


@dataclass(frozen=True, kw_only=True)
class HandRig:
    """The rest pose of a hand. Lengths in meters, in world coordinates at the time of binding.

    Points embedded in tetrahedra have four barycentric coordinates that sum to one; some are
    negative for points slightly outside their tetrahedron.

    Raises:
        ValueError: The shapes of arrays are inconsistent, or values are not finite.
    """

    side: str
    """Which hand: left or right, or empty if unknown."""
    vertices: NDArray[np.float64]
    """Vertices of the skin, shape [V, 3]."""
    faces: NDArray[np.int32]
    """Triangles of the closed skin, wound outward, shape [F, 3]."""
    bone_names: tuple[str, ...]
    """Names of the B bones, in the order of all arrays of bones."""
    bone_rest: NDArray[np.float64]
    """Rest matrix of each bone, bone to world, shape [B, 4, 4]."""
    bone_parent: NDArray[np.int32]
    """Index of each bone's parent, -1 for a root, shape [B]; parents come before children."""
    nodes: NDArray[np.float64]
    """Nodes of the flesh, shape [N, 3]."""
    tetrahedra: NDArray[np.int32]
    """Nodes of each tetrahedron, of positive volume, shape [T, 4]."""
    node_bones: NDArray[np.int32]
    """Bones that carry each node, shape [N, 4]."""
    node_weights: NDArray[np.float64]
    """Weights of these bones, rows summing to one, shape [N, 4]."""
    vertex_tetrahedron: NDArray[np.int32]
    """Tetrahedron that carries each vertex of the skin, shape [V]."""
    vertex_weights: NDArray[np.float64]
    """Barycentric coordinates in it, shape [V, 4]."""
    ghost_tetrahedron: NDArray[np.int32]
    """Tetrahedron that carries each ghost, shape [G]."""
    ghost_weights: NDArray[np.float64]
    """Barycentric coordinates in it, shape [G, 4]."""
    ghost_normals: NDArray[np.float64]
    """Outward unit normals of ghosts on the surface, zero for those inside, shape [G, 3]."""
    ghost_areas: NDArray[np.float64]
    """Area of the skin that each ghost represents [m²], zero for those inside, shape [G]."""
    ghost_spacing: float
    """Distance between neighboring ghosts [m]."""

    def __post_init__(self) -> None:
        vertices, bones, nodes = len(self.vertices), len(self.bone_names), len(self.nodes)
        ghosts, tetrahedra = len(self.ghost_tetrahedron), len(self.tetrahedra)
        expected = {
            "vertices": (vertices, 3),
            "faces": (len(self.faces), 3),
            "bone_rest": (bones, 4, 4),
            "bone_parent": (bones,),
            "nodes": (nodes, 3),
            "tetrahedra": (tetrahedra, 4),
            "node_bones": (nodes, MAX_BONES),
            "node_weights": (nodes, MAX_BONES),
            "vertex_tetrahedron": (vertices,),
            "vertex_weights": (vertices, 4),
            "ghost_tetrahedron": (ghosts,),
            "ghost_weights": (ghosts, 4),
            "ghost_normals": (ghosts, 3),
            "ghost_areas": (ghosts,),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise ValueError(f"HandRig.{name} has shape {array.shape}; expected {shape}.")
            if not np.isfinite(array).all():
                raise ValueError(f"HandRig.{name} has values that are not finite.")
        for name, count in (
            ("faces", vertices),
            ("tetrahedra", nodes),
            ("node_bones", bones),
            ("vertex_tetrahedron", tetrahedra),
            ("ghost_tetrahedron", tetrahedra),
        ):
            array = getattr(self, name)
            if array.size and not (array.min() >= 0 and array.max() < count):
                raise ValueError(f"HandRig.{name} has indices out of range.")

    def skinned_nodes(self, bones: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Positions of the nodes by linear blend skinning, without elasticity [m], shape [N, 3].

        Args:
            bones: Matrices of bones by name, bone to world, shape [4, 4]; other bones stay at rest.
        """
        matrices = np.tile(np.eye(4), (len(self.bone_names), 1, 1))
        for index, name in enumerate(self.bone_names):
            if name in bones:
                pose = np.asarray(bones[name], np.float64)
                matrices[index] = pose @ np.linalg.inv(self.bone_rest[index])
        blended = np.einsum("nk,nkij->nij", self.node_weights, matrices[self.node_bones])
        return np.einsum("nij,nj->ni", blended[:, :3, :3], self.nodes) + blended[:, :3, 3]

    def carried_vertices(self, nodes: NDArray[np.floating]) -> NDArray[np.float64]:
        """Positions of the skin for given positions of the nodes [m], shape [V, 3]."""
        return _carried(nodes, self.tetrahedra[self.vertex_tetrahedron], self.vertex_weights)

    def carried_ghosts(self, nodes: NDArray[np.floating]) -> NDArray[np.float64]:
        """Positions of the ghosts for given positions of the nodes [m], shape [G, 3]."""
        return _carried(nodes, self.tetrahedra[self.ghost_tetrahedron], self.ghost_weights)

    def to_arrays(self) -> dict[str, NDArray]:
        """All fields as arrays, for `from_arrays` and for files."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> HandRig:
        """Create a rig from the result of `to_arrays`.

        Raises:
            ValueError: An array is missing or inconsistent; the message names it.
        """
        missing = [field.name for field in fields(cls) if field.name not in arrays]
        if missing:
            raise ValueError(f"The stored hand lacks {', '.join(missing)}; bind it again.")
        values: dict[str, Any] = {field.name: arrays[field.name] for field in fields(cls)}
        values["side"] = str(values["side"])
        values["bone_names"] = tuple(str(name) for name in values["bone_names"])
        values["ghost_spacing"] = float(values["ghost_spacing"])
        return cls(**values)


def _carried(
    nodes: NDArray[np.floating], corners: NDArray[np.int32], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.einsum("gk,gkd->gd", weights, np.asarray(nodes, np.float64)[corners])
