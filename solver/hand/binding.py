# SPDX-License-Identifier: GPL-3.0-or-later
"""Binding: converts a rigged skin to a hand for simulation.

After section III-D of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: the interior is meshed with tetrahedra, and ghost particles rasterized in the rest pose
are embedded in the tetrahedron around them by barycentric coordinates.

Ghosts lie only on the skin. A particle meets the skin on its own side before it gets inside, and
one that ends up inside when the hand jumps is moved out along the nearest skin's normal. Ghosts
inside the hand would have neither a normal nor an area, and would push in all directions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..geometry.closed_mesh import MeshError, check_closed_mesh, mesh_area, mesh_volume
from ..geometry.lattice_tetrahedra import barycentric_weights, carriers
from ..geometry.skin_query import SkinQuery
from .bone_names import named_parents
from .flesh import FleshMesh, hand_flesh
from .flesh_weights import flesh_weights
from .ghosts import SurfaceGhosts, rasterize_ghosts
from .parts import PALM, HandParts, hand_parts, skin_edges, skin_pieces
from .rig import HandRig
from .skinned_hand import SkinnedHand

NODE_COUNT = 500
"""Approximate number of nodes of a hand when no cell size is given."""
GHOST_SPACING = 0.5
"""Ghost spacing over particle spacing: ghosts are a particle's radius apart, so that no particle
leaks through. A square lattice of ghosts leaks balls with radii below 1/√2 of its spacing."""
MAX_NODES = 100_000
MAX_GHOSTS = 1_000_000
"""Larger numbers of nodes or ghosts are assumed to be a mistake in units."""
MAX_OUTSIDE = 1.0
"""How far skin may lie outside the tetrahedron that carries it, relative to its height."""
_MAX_CELL = 0.25
"""Largest lattice cell, relative to the hand's longest extent."""


def bind_hand(hand: SkinnedHand, *, clay_spacing: float, cell: float | None = None) -> HandRig:
    """Bind a rigged hand for simulation with clay.

    Args:
        hand: Skin, skeleton and weights in the rest pose. Vertices at the same position are merged.
        clay_spacing: Distance between neighboring clay particles [m]; ghosts lie half as far apart.
        cell: Edge of the cubic lattice cells that are cut into tetrahedra [m]; by default chosen
            to give about 500 nodes.

    Returns:
        The hand. Its skin has the given vertices in order, without duplicates.

    Raises:
        MeshError: The skin is open (the message gives the number of holes), inside out or in
            several pieces, or has coordinates that are not finite or vertices without bone weights.
        ValueError: The bones do not form a skeleton, or the hand is too small or too large for the
            spacing or cell.
    """
    if not (np.isfinite(clay_spacing) and clay_spacing > 0.0):
        raise ValueError(f"The clay's spacing is {clay_spacing!r} m; it must be above 0.")
    vertices, faces, weights = _checked_skin(hand)
    _check_bones(hand)
    parents = hand.bone_parent
    if (parents < 0).all():
        parents = named_parents(hand.bone_names)
    order = _parents_first(parents)
    weights, rest = weights[:, order], hand.bone_rest[order]
    parent = np.array([order.index(parents[b]) if parents[b] >= 0 else -1 for b in order], np.int32)
    cell = _checked_cell(vertices, faces, cell)
    spacing = GHOST_SPACING * clay_spacing
    ghosts = _ghosts(vertices, faces, spacing)

    parts = hand_parts(vertices, faces)
    flesh = _flesh_in_own_frame(vertices, faces, parts, cell)
    nearest = faces[ghosts.face, ghosts.weights.argmax(1)]
    points = np.concatenate([vertices, ghosts.positions(vertices, faces)])
    owner = np.concatenate([np.arange(len(vertices)), nearest])
    carrier, share = _embedded(points, owner, parts, flesh, cell)
    ghost_weights = np.einsum("gk,gkb->gb", ghosts.weights, weights[faces[ghosts.face]])
    nodes = flesh.tetrahedra.points
    node_bones, node_weights = flesh_weights(
        flesh.tetrahedra,
        carrier,
        share,
        points,
        np.concatenate([weights, ghost_weights]),
        rest[:, :3, 3],
        parent,
    )
    split = len(vertices)
    return HandRig(
        side=hand.side,
        vertices=vertices,
        faces=faces,
        bone_names=tuple(hand.bone_names[bone] for bone in order),
        bone_rest=rest,
        bone_parent=parent,
        nodes=nodes,
        tetrahedra=flesh.tetrahedra.corners,
        node_bones=node_bones,
        node_weights=node_weights,
        vertex_tetrahedron=carrier[:split],
        vertex_weights=share[:split],
        ghost_tetrahedron=carrier[split:],
        ghost_weights=share[split:],
        ghost_normals=ghosts.normals(vertices, faces),
        ghost_areas=ghosts.area,
        ghost_spacing=spacing,
    )


# Input checks ------------------------------------------------------------------------------------


def _checked_skin(
    hand: SkinnedHand,
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Weld vertices, drop degenerate faces and normalize weights; raise if something is wrong."""
    name = "The hand"
    check_closed_mesh(hand.vertices, hand.faces, name=name)
    vertices = np.asarray(hand.vertices, np.float64)
    _, first, welded = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    kept = np.sort(first)
    index = np.searchsorted(kept, first)[welded.reshape(-1)]
    vertices, faces = vertices[kept], index[hand.faces].astype(np.int32)
    proper = (np.diff(np.sort(faces, axis=1), axis=1) > 0).all(1)
    faces = np.ascontiguousarray(faces[proper])
    if mesh_volume(vertices, faces) < 0.0:
        raise MeshError(
            f"{name} is inside out: its faces point inwards. Recalculate its normals to the "
            "outside (Mesh > Normals > Recalculate Outside)."
        )
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    if not used.all():
        raise MeshError(
            f"{name} has {int((~used).sum())} vertices without a face. Delete the loose ones "
            "(Mesh > Clean Up > Delete Loose)."
        )
    pieces = len(np.unique(skin_pieces(len(vertices), skin_edges(faces))))
    if pieces > 1:
        raise MeshError(
            f"{name} has {pieces} separate pieces, but must be one closed surface. Join them (for "
            "example with a Remesh modifier), or separate the parts that are not the hand."
        )
    weights = np.asarray(hand.weights, np.float64)[kept]
    if not np.isfinite(weights).all() or (weights < 0.0).any():
        raise MeshError(f"{name} has vertex weights that are negative or not finite.")
    total = weights.sum(1)
    unrigged = int((total < 1e-6).sum())
    if unrigged:
        raise MeshError(
            f"{name} has {unrigged} of {len(vertices)} vertices without bone weights. Assign "
            "weights (for example with Armature > With Automatic Weights)."
        )
    return vertices, faces, weights / total[:, None]


def _check_bones(hand: SkinnedHand) -> None:
    count = len(hand.bone_names)
    if count == 0:
        raise ValueError("The hand has no bones.")
    if len(set(hand.bone_names)) < count:
        raise ValueError("Two bones of the hand have the same name.")
    rest = np.asarray(hand.bone_rest, np.float64)
    if not np.isfinite(rest).all() or (np.abs(np.linalg.det(rest[:, :3, :3])) < 1e-12).any():
        raise ValueError("A bone's rest matrix is not finite, or its scale is zero.")
    if ((hand.bone_parent < -1) | (hand.bone_parent >= count)).any():
        raise ValueError("A bone's parent does not exist.")


def _parents_first(parents: NDArray[np.int32]) -> list[int]:
    """Order bones so that parents come before children; raise ValueError if they form a cycle."""
    order: list[int] = []
    waiting = list(range(len(parents)))
    while waiting:
        ready = [bone for bone in waiting if parents[bone] < 0 or parents[bone] in order]
        if not ready:
            raise ValueError("The hand's bones form a loop: a bone is its own ancestor.")
        order += ready
        waiting = [bone for bone in waiting if bone not in ready]
    return order


def _checked_cell(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], cell: float | None
) -> float:
    volume = mesh_volume(vertices, faces)
    if cell is None:
        return default_cell(volume, mesh_area(vertices, faces))
    if not (np.isfinite(cell) and cell > 0.0):
        raise ValueError(f"The lattice cell is {cell!r} m; it must be above 0.")
    coarsest = _MAX_CELL * float(np.ptp(vertices, axis=0).max())
    if cell > coarsest:
        raise ValueError(
            f"A lattice cell of {cell:.3g} m is too coarse for a hand of this size; the maximum "
            f"is {coarsest:.2g} m."
        )
    if 2.0 * volume / cell**3 > MAX_NODES:
        raise ValueError(
            f"A lattice cell of {cell:.3g} m would require more than {MAX_NODES:,} nodes; use at "
            f"least {(2.0 * volume / MAX_NODES) ** (1 / 3):.2g} m."
        )
    return cell


def default_cell(volume: float, area: float) -> float:
    """Cell edge [m] that gives a hand of this volume [m³] and skin area [m²] about 500 nodes."""
    low, high = 1e-3 * volume ** (1 / 3), 10.0 * volume ** (1 / 3)
    for _ in range(60):
        cell = 0.5 * (low + high)
        # Two nodes per cell, inside the hand and in the layer of cells that its skin cuts.
        if 2.0 * (volume + 0.93 * cell * area) / cell**3 > NODE_COUNT:
            low = cell
        else:
            high = cell
    return high


def _ghosts(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], spacing: float
) -> SurfaceGhosts:
    expected = mesh_area(vertices, faces) / spacing**2
    if expected > MAX_GHOSTS:
        raise ValueError(
            f"Clay with a spacing of {spacing / GHOST_SPACING:.3g} m would require "
            f"{expected:,.0f} ghosts on this hand; check the units of both."
        )
    if expected < 100.0:
        raise ValueError(
            f"Clay with a spacing of {spacing / GHOST_SPACING:.3g} m is too coarse for this hand: "
            f"its skin would have {expected:.0f} ghosts. Use finer clay or check the hand's units."
        )
    return rasterize_ghosts(vertices, faces, spacing)


# Flesh -------------------------------------------------------------------------------------------


def _flesh_in_own_frame(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], parts: HandParts, cell: float
) -> FleshMesh:
    """Fill a hand along its principal axes, so that the result is independent of its placement."""
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    center = np.average(corners.mean(1), axis=0, weights=area)
    offset = (corners.mean(1) - center) * np.sqrt(area / area.sum())[:, None]
    axes = np.linalg.svd(offset, full_matrices=False)[2].T
    axes[:, 2] *= np.linalg.det(axes)
    own = (vertices - center) @ axes
    flesh = hand_flesh(SkinQuery(own, faces), own, faces, parts, cell)
    nodes = flesh.tetrahedra.points @ axes.T + center
    return replace(flesh, tetrahedra=replace(flesh.tetrahedra, points=nodes))


# Embedding ---------------------------------------------------------------------------------------


def _embedded(
    points: NDArray[np.float64],
    nearest: NDArray[np.integer],
    parts: HandParts,
    flesh: FleshMesh,
    cell: float,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Tetrahedra, shape [P], and barycentric coordinates, [P, 4], of points in their own part."""
    # Palm near a finger's root may be carried by the finger's tetrahedra at the root.
    root_group = 1 + parts.finger_count
    group = flesh.part + root_group * flesh.at_root
    part = parts.part[nearest]
    allowed = np.column_stack([part, part])
    if parts.finger_count:
        root = np.where(part == PALM, 1 + parts.beyond[nearest].argmin(1), part)
        allowed[:, 1] = root_group + root
    carrier, outside = carriers(points, flesh.tetrahedra, group, allowed, cell)
    if (carrier < 0).any() or outside.min() < -MAX_OUTSIDE:
        raise ValueError(
            f"A lattice cell of {cell:.3g} m is too coarse for this hand: parts of its skin are "
            "far from every tetrahedron. Use a smaller cell."
        )
    corners = flesh.tetrahedra.points[flesh.tetrahedra.corners[carrier]]
    return carrier, barycentric_weights(points, corners)
