# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigs with simple shapes for experiments with soft hands: a finger and a slab."""

import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray

from tactile_clay.solver.hand.ghosts import rasterize_ghosts
from tactile_clay.solver.hand.rig import HandRig


@wp.kernel(enable_backward=False)
def find_inside(mesh: wp.uint64, points: wp.array[wp.vec3], inside: wp.array[int]) -> None:
    """Mark the points inside a mesh."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], 1.0)
    if query.result and query.sign < 0.0:
        inside[i] = 1


def lattice(
    vertices: NDArray, faces: NDArray, edge: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Cover a closed mesh with tetrahedra of a body-centered cubic lattice.

    Returns:
        Nodes [m], shape [N, 3], and tetrahedra of positive volume, shape [T, 4].
    """
    low = vertices.min(0) - 0.61 * edge
    size = np.ceil((vertices.max(0) + 0.61 * edge - low) / edge).astype(int) + 1
    counts = (int(size[0]), int(size[1]), int(size[2]))
    corners = (counts[0] + 1, counts[1] + 1, counts[2] + 1)
    corner = np.arange(int(np.prod(corners))).reshape(corners)
    center = np.arange(int(np.prod(counts))).reshape(counts) + corner.size
    nodes = np.concatenate(
        [
            np.indices(corners).reshape(3, -1).T.astype(float),
            np.indices(counts).reshape(3, -1).T + 0.5,
        ]
    )
    tetrahedra = []
    for axis in range(3):
        first = np.moveaxis(center, axis, 0)[:-1].ravel()
        second = np.moveaxis(center, axis, 0)[1:].ravel()
        ring = np.moveaxis(corner, axis, 0)[1:-1]
        face = _face_corners(ring)
        for k in range(4):
            tetrahedra.append(
                np.column_stack([first, second, face[k].ravel(), face[(k + 1) % 4].ravel()])
            )
    tets = np.concatenate(tetrahedra)
    nodes = low + edge * nodes
    volume = np.linalg.det(nodes[tets[:, 1:]] - nodes[tets[:, :1]])
    tets[volume < 0.0] = tets[volume < 0.0][:, [1, 0, 2, 3]]
    steps = np.indices((5,) * 3).reshape(3, -1).T
    steps = steps[steps.sum(1) <= 4]
    weights = (np.column_stack([4 - steps.sum(1), steps]) * 0.98 + 0.02) / 4.0
    weights /= weights.sum(1, keepdims=True)
    points = np.einsum("sk,tkd->tsd", weights, nodes[tets])
    inside = is_inside(vertices, faces, points.reshape(-1, 3)).reshape(len(tets), -1)
    tets = tets[inside.any(1)]
    used, tets = np.unique(tets, return_inverse=True)
    return nodes[used], tets.reshape(-1, 4).astype(np.int32)


def _face_corners(ring: NDArray) -> list[NDArray]:
    """The four corners of the faces between cells, in order."""
    return [ring[:, :-1, :-1], ring[:, 1:, :-1], ring[:, 1:, 1:], ring[:, :-1, 1:]]


def is_inside(vertices: NDArray, faces: NDArray, points: NDArray) -> NDArray[np.bool_]:
    """Whether each point lies inside a closed mesh, shape [P]."""
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(np.asarray(faces).ravel(), dtype=int, device="cpu"),
        support_winding_number=True,
    )
    inside = wp.zeros(len(points), dtype=int, device="cpu")
    places = wp.array(points, dtype=wp.vec3, device="cpu")
    wp.launch(find_inside, dim=len(points), inputs=[mesh.id, places, inside], device="cpu")
    return inside.numpy().astype(bool)


def embed(
    points: NDArray, nodes: NDArray, tetrahedra: NDArray
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Find the tetrahedron around or closest to each point, and its barycentric weights."""
    corners = nodes[tetrahedra]
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    middle = corners.mean(1)
    index = np.zeros(len(points), np.int32)
    weights = np.zeros((len(points), 4))
    for row, point in enumerate(points):
        near = np.argsort(((middle - point) ** 2).sum(1), kind="stable")[:40]
        part = np.einsum("tij,tj->ti", inverse[near], point - corners[near, 0])
        whole = np.column_stack([1.0 - part.sum(1), part])
        best = int(whole.min(1).argmax())
        index[row], weights[row] = near[best], whole[best]
    return index, weights


def bind(
    skin: trimesh.Trimesh,
    heads: NDArray,
    parents: list[int],
    weights: NDArray,
    nodes: NDArray,
    tetrahedra: NDArray,
    ghost_spacing: float,
) -> HandRig:
    """Assemble a rig.

    Args:
        skin: The skin.
        heads: Heads of the bones [m], shape [B, 3].
        parents: Parent of each bone, -1 for a root.
        weights: How much each bone carries each node, shape [N, B].
        nodes: Nodes of the flesh [m], shape [N, 3].
        tetrahedra: Tetrahedra of the flesh, shape [T, 4].
        ghost_spacing: Spacing of the ghosts [m].
    """
    vertices, faces = np.asarray(skin.vertices), np.asarray(skin.faces, np.int32)
    bone_rest = np.tile(np.eye(4), (len(heads), 1, 1))
    bone_rest[:, :3, 3] = heads
    bone_count = min(4, weights.shape[1])
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :bone_count]
    shares = np.take_along_axis(weights, bones, 1)
    shares = shares / shares.sum(1, keepdims=True)
    bones = np.pad(bones, ((0, 0), (0, 4 - bone_count)))
    shares = np.pad(shares, ((0, 0), (0, 4 - bone_count)))
    ghosts = rasterize_ghosts(vertices, faces, ghost_spacing)
    vertex_tetrahedron, vertex_weights = embed(vertices, nodes, tetrahedra)
    ghost_tetrahedron, ghost_weights = embed(ghosts.positions(vertices, faces), nodes, tetrahedra)
    return HandRig(
        side="right",
        vertices=vertices,
        faces=faces,
        bone_names=tuple(f"bone_{k}" for k in range(len(heads))),
        bone_rest=bone_rest,
        bone_parent=np.array(parents, np.int32),
        nodes=nodes,
        tetrahedra=tetrahedra,
        node_bones=bones.astype(np.int32),
        node_weights=shares,
        vertex_tetrahedron=vertex_tetrahedron,
        vertex_weights=vertex_weights,
        ghost_tetrahedron=ghost_tetrahedron,
        ghost_weights=ghost_weights,
        ghost_normals=ghosts.normals(vertices, faces),
        ghost_areas=ghosts.area,
        ghost_spacing=ghost_spacing,
    )


def finger(
    edge: float = 0.006,
    *,
    radius: float = 0.008,
    length: float = 0.05,
    ghost_spacing: float = 0.0025,
) -> HandRig:
    """A finger that points down: three bones along its axis, its tip at the origin."""
    skin = trimesh.creation.capsule(height=length - 2 * radius, radius=radius, count=(24, 24))
    skin.apply_translation((0, 0, radius - skin.bounds[0, 2] - radius))
    vertices, faces = trimesh.remesh.subdivide_to_size(skin.vertices, skin.faces, 0.005)
    skin = trimesh.Trimesh(vertices, faces)
    nodes, tetrahedra = lattice(skin.vertices, skin.faces, edge)
    heads = np.array([[0, 0, length - radius], [0, 0, 0.5 * length], [0, 0, radius]])
    blend = np.clip((nodes[:, 2] - 0.5 * length) / (0.5 * radius) + 0.5, 0.0, 1.0)
    weights = np.column_stack([blend, 1.0 - blend, np.zeros(len(nodes))])
    return bind(skin, heads, [-1, 0, 1], weights, nodes, tetrahedra, ghost_spacing)


def slab(
    edge: float = 0.009,
    *,
    size: tuple[float, float, float] = (0.09, 0.09, 0.025),
    ghost_spacing: float = 0.0025,
) -> HandRig:
    """A flat palm: a slab on four bones side by side, its top at z = 0."""
    skin = trimesh.creation.box(size)
    skin.apply_translation((0, 0, -0.5 * size[2]))
    vertices, faces = trimesh.remesh.subdivide_to_size(skin.vertices, skin.faces, 0.008)
    skin = trimesh.Trimesh(vertices, faces)
    nodes, tetrahedra = lattice(skin.vertices, skin.faces, edge)
    across = (np.arange(4) - 1.5) * size[0] / 4
    back, middle = -0.5 * size[1], -0.5 * size[2]
    heads = np.array(
        [[0, back, middle]]
        + [[x, back, middle] for x in across]
        + [[x, -back, middle] for x in across]
    )
    parents = [-1, 0, 0, 0, 0, 1, 2, 3, 4]
    weights = np.zeros((len(nodes), len(heads)))
    weights[np.arange(len(nodes)), 1 + np.abs(nodes[:, :1] - across).argmin(1)] = 1.0
    return bind(skin, heads, parents, weights, nodes, tetrahedra, ghost_spacing)


def posed(rig: HandRig, pose: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Bone poses of a rig moved rigidly from its rest pose."""
    return {name: pose @ rest for name, rest in zip(rig.bone_names, rig.bone_rest, strict=True)}
