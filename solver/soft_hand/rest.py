# SPDX-License-Identifier: GPL-3.0-or-later
"""The flesh of a bound hand at rest: the shares of skin interior and bone in each tetrahedron.

Tetrahedra of a lattice protrude from the skin, and bones run through them. Both are integrated over
sample points, so that stiffness hardly depends on the position or resolution of the lattice. The
volume outside the skin has no stiffness (the finite cell method: Parvizian, Düster and Rank,
Computational Mechanics 41, 2007, doi 10.1007/s00466-007-0173-y), and the volume inside a bone is
tied to its skinned position by an elastic foundation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..hand.rig import HandRig

SAMPLE_ORDER = 3
"""Number of intervals along each edge of the lattice of sample points in a tetrahedron."""
BONE_SHARE = 0.5
"""Radius of a bone, relative to the distance from its axis to the skin."""
FOUNDATION_LENGTH = 1.0e-3
"""Thickness of the elastic foundation on a bone [m]; its stiffness is the modulus over the squared
thickness."""
FOUNDATION_CELLS = 0.133
"""The same in cells of the lattice, if that is larger. A tetrahedron that reaches from bone to skin
strains uniformly: if one end were fixed, the other could not yield. With this value, the compliance
of a fingertip varies by about a tenth between one and four cells across it."""
MIN_SHARE = 0.1
"""Smallest share of a tetrahedron's volume that is counted, so that all nodes are attached."""
LEAF_REACH = 1.6
"""Length of a bone without children, relative to the distance from its head to the center of the
nodes it carries."""


@dataclass(frozen=True)
class FleshRest:
    """The flesh at rest."""

    gradients: NDArray[np.float64]
    """Gradients of the four shape functions of each tetrahedron [1/m], shape [T, 4, 3]."""
    volumes: NDArray[np.float64]
    """Volume of each tetrahedron inside the skin [m³], shape [T]."""
    bone_shares: NDArray[np.float64]
    """Integrals of products of two shape functions over the bone in each tetrahedron [m³],
    shape [T, 4, 4]; they sum to the volume of the bones."""
    foundation_length: float
    """Thickness of the elastic foundation on a bone [m]."""


def bone_axes(rig: HandRig) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Start and end points of the bones' axes.

    Axes run from a bone's head to the heads of its children. The axis of a bone without children
    runs through the center of the nodes that it carries.

    Returns:
        Starts and ends [m], shape [A, 3] each.
    """
    heads = rig.bone_rest[:, :3, 3]
    starts, ends = [], []
    parents = set(rig.bone_parent.tolist())
    for bone, parent in enumerate(rig.bone_parent):
        if parent >= 0:
            starts.append(heads[parent])
            ends.append(heads[bone])
        if bone not in parents:
            share = (rig.node_weights * (rig.node_bones == bone)).sum(1)
            if share.sum() > 0.0:
                middle = share @ rig.nodes / share.sum()
                starts.append(heads[bone])
                ends.append(heads[bone] + LEAF_REACH * (middle - heads[bone]))
    return np.array(starts).reshape(-1, 3), np.array(ends).reshape(-1, 3)


def flesh_rest(rig: HandRig) -> FleshRest:
    """Compute the flesh of a rig in its rest pose."""
    corners = rig.nodes[rig.tetrahedra]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)
    volumes = np.linalg.det(edges) / 6.0

    weights = _sample_weights()
    points = np.einsum("sk,tkd->tsd", weights, corners).reshape(-1, 3)
    depth = _depth(rig, points)
    starts, ends = bone_axes(rig)
    away = _distance_to_axes(points, starts, ends)
    inside = (depth > 0.0).reshape(len(volumes), -1)
    bone = inside & (away * (1.0 - BONE_SHARE) < depth * BONE_SHARE).reshape(inside.shape)
    products = np.einsum("sk,sl->skl", weights, weights) / len(weights)
    bone_shares = np.einsum("t,ts,skl->tkl", volumes, bone.astype(float), products)
    share = np.maximum(inside.mean(1), MIN_SHARE)
    # Twelve tetrahedra of a body-centered cubic lattice fill a cell.
    cell = float(np.cbrt(12.0 * volumes.mean()))
    foundation_length = max(FOUNDATION_LENGTH, FOUNDATION_CELLS * cell)
    return FleshRest(gradients, volumes * share, bone_shares, foundation_length)


def _sample_weights() -> NDArray[np.float64]:
    """Barycentric coordinates of the sample points, shape [S, 4]."""
    steps = np.indices((SAMPLE_ORDER + 1,) * 3).reshape(3, -1).T
    steps = steps[steps.sum(1) <= SAMPLE_ORDER]
    steps = np.column_stack([SAMPLE_ORDER - steps.sum(1), steps])
    return (steps.astype(np.float64) + 0.25) / (SAMPLE_ORDER + 1.0)


@wp.kernel(enable_backward=False)
def measure_depth(
    mesh: wp.uint64, reach: float, points: wp.array[wp.vec3], depth: wp.array[float]
) -> None:
    """Compute the depth of points under the skin, negative outside."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], reach)
    depth[i] = -reach
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        depth[i] = -query.sign * wp.length(points[i] - nearest)


def _depth(rig: HandRig, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth of points under the skin [m], negative outside, shape [P]."""
    # Centered, where float32 has the highest resolution.
    middle = rig.vertices.mean(0)
    skin = wp.Mesh(
        points=wp.array(rig.vertices - middle, dtype=wp.vec3, device="cpu"),
        indices=wp.array(rig.faces.ravel(), dtype=int, device="cpu"),
        support_winding_number=True,
    )
    reach = float(np.linalg.norm(np.ptp(np.concatenate([rig.vertices, rig.nodes]), axis=0)))
    depth = wp.zeros(len(points), dtype=float, device="cpu")
    centered = wp.array(points - middle, dtype=wp.vec3, device="cpu")
    inputs = [skin.id, reach, centered, depth]
    wp.launch(measure_depth, dim=len(points), inputs=inputs, device="cpu")
    return depth.numpy().astype(float)


def _distance_to_axes(
    points: NDArray[np.float64], starts: NDArray[np.float64], ends: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance of points to the nearest bone axis [m], shape [P]."""
    nearest = np.full(len(points), np.inf)
    for start, end in zip(starts, ends, strict=True):
        axis = end - start
        offset = points - start
        along = np.clip(offset @ axis / max(float(axis @ axis), 1e-18), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(offset - along[:, None] * axis, axis=1))
    return nearest
