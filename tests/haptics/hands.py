# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands for tests of touch: the generated mesh, bound to its joints without flesh."""

from collections.abc import Callable
from functools import cache

import numpy as np

from tactile_clay.solver.hand.mesh import hand_mesh
from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.hand.shape import HandPose, hand_shape

__all__ = ["bare_rig", "hand_shape", "vertex_normals_and_areas"]

PARENTS = {"palm": "wrist", "wrist": ""}


def parent_of(name: str) -> str:
    """Name of a joint's parent."""
    if name in PARENTS:
        return PARENTS[name]
    finger, _, segment = name.partition("_")
    order = ["metacarpal", "proximal", "intermediate", "distal", "tip"]
    if finger == "thumb":
        order.remove("intermediate")
    place = order.index(segment)
    return f"{finger}_{order[place - 1]}" if place else "wrist"


def bare_rig(
    side: str = "right",
    *,
    length: float = 0.19,
    pose: str | HandPose = "flat",
    edge_length: float | None = None,
    named: Callable[[str], str] = lambda name: name,
    tips: bool = True,
    told_side: str | None = None,
) -> HandRig:
    """Bind the generated hand: each vertex is a ghost and a node, carried by the nearest bone.

    Args:
        side: ``right`` or ``left``.
        length: Length of the hand [m].
        pose: Pose of the hand.
        edge_length: Edge length of the mesh [m].
        named: Gives the bone name for a joint of OpenXR.
        tips: Whether to keep the joints in the fingertips.
        told_side: The rig's own `side`; the same as `side` if None.
    """
    vertices, faces = _mesh(side, length, pose, edge_length)
    shape = hand_shape(side, length=length, pose=pose)
    joints = [name for name in shape.joints if tips or not name.endswith("_tip")]
    joints.sort(key=lambda name: (len(_ancestors(name)), name))
    names = tuple(joints)
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    for index, name in enumerate(names):
        rest[index, :3, :3], rest[index, :3, 3] = shape.axes[name], shape.joints[name]
    parents = np.array([names.index(parent_of(n)) if parent_of(n) else -1 for n in names])
    carrier = _nearest_bones(vertices, {n: shape.joints[n] for n in shape.joints}, names)

    # Every vertex is the first corner of a tetrahedron of its own.
    count = len(vertices)
    corners = 1e-3 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    nodes = (vertices[:, None] + corners).reshape(-1, 3)
    bones = np.zeros((4 * count, 4), np.int32)
    bones[:, 0] = np.repeat(carrier, 4)
    weights = np.tile((1.0, 0.0, 0.0, 0.0), (4 * count, 1))
    first = np.tile((1.0, 0.0, 0.0, 0.0), (count, 1))
    normals, areas = vertex_normals_and_areas(vertices, faces)
    return HandRig(
        side=side if told_side is None else told_side,
        vertices=vertices,
        faces=faces,
        bone_names=tuple(named(name) for name in names),
        bone_rest=rest,
        bone_parent=parents.astype(np.int32),
        nodes=nodes,
        tetrahedra=np.arange(4 * count, dtype=np.int32).reshape(-1, 4),
        node_bones=bones,
        node_weights=weights,
        vertex_tetrahedron=np.arange(count, dtype=np.int32),
        vertex_weights=first,
        ghost_tetrahedron=np.arange(count, dtype=np.int32),
        ghost_weights=first,
        ghost_normals=normals,
        ghost_areas=areas,
        ghost_spacing=float(np.sqrt(np.median(areas))),
    )


@cache
def _mesh(side: str, length: float, pose: str | HandPose, edge_length: float | None):
    """The mesh, cached for each kind of hand."""
    return hand_mesh(side, length=length, pose=pose, edge_length=edge_length)


def vertex_normals_and_areas(vertices: np.ndarray, faces: np.ndarray):
    """Unit normals and surrounding areas [m²] of the vertices of a closed mesh."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals, areas = np.zeros_like(vertices), np.zeros(len(vertices))
    for column in range(3):
        np.add.at(normals, faces[:, column], cross)
        np.add.at(areas, faces[:, column], np.linalg.norm(cross, axis=1) / 6.0)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True), areas


def _ancestors(name: str) -> list[str]:
    found = []
    while parent_of(name):
        name = parent_of(name)
        found.append(name)
    return found


def _nearest_bones(vertices: np.ndarray, joints: dict, names: tuple[str, ...]) -> np.ndarray:
    """Index of the bone nearest to each vertex; a bone extends to its child joints."""
    best = np.full(len(vertices), np.inf)
    carrier = np.zeros(len(vertices), np.int32)
    for name, place in joints.items():
        parent = parent_of(name)
        if not parent or parent not in names:
            continue
        start, edge = joints[parent], place - joints[parent]
        along = np.clip((vertices - start) @ edge / max(edge @ edge, 1e-12), 0.0, 1.0)
        distance = np.linalg.norm(vertices - start - along[:, None] * edge, axis=1)
        nearer = distance < best
        best[nearer], carrier[nearer] = distance[nearer], names.index(parent)
    return carrier
