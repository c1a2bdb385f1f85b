# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin bodies around flat meshes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.solver.geometry.rotations import matrices_from_rotation_vectors
from tactile_clay.solver.geometry.sheet import sheet_triangles, sheet_vertices


@given(
    columns=st.integers(1, 5),
    rows=st.integers(1, 4),
    seed=st.integers(0, 1000),
    hole=st.booleans(),
)
def test_sheet_is_closed_and_has_its_volume(columns: int, rows: int, seed: int, hole: bool) -> None:
    """However the mesh lies, is wound and has holes."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    number = np.arange(x.size).reshape(x.shape)
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    quads = np.stack(corners, -1).reshape(-1, 4)
    if hole and len(quads) > 1:
        quads = np.delete(quads, rng.integers(len(quads)), 0)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    flipped = rng.random(len(triangles)) < 0.5
    triangles[flipped] = triangles[flipped][:, ::-1]
    rotation = matrices_from_rotation_vectors(rng.normal(size=(1, 3)))[0]
    vertices = vertices @ rotation.T + rng.normal(size=3)
    normal = rotation[:, 2]
    body = trimesh.Trimesh(
        sheet_vertices(vertices, normal, 0.1),
        sheet_triangles(vertices, triangles.astype(np.int32), normal),
        process=False,
    )
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume == pytest.approx(0.1 * len(quads), rel=1e-6)
