# SPDX-License-Identifier: GPL-3.0-or-later
"""Ghost particles on a mesh: coverage and motion."""

import numpy as np
import pytest
import trimesh
import warp as wp

from tactile_clay.solver.hand.ghosts import GhostMesh, rasterize_ghosts

SPACING = 0.003
SHAPES = {
    "ball": trimesh.creation.icosphere(subdivisions=3, radius=0.012),
    "box": trimesh.creation.box((0.03, 0.02, 0.01)),
    "thin sheet": trimesh.creation.box((0.03, 0.02, 0.0004)),
    "sliver": trimesh.creation.cone(radius=0.002, height=0.04, sections=8),
    "fine": trimesh.creation.icosphere(subdivisions=4, radius=0.004),
}


@pytest.mark.parametrize("name", SHAPES)
def test_no_gap_is_wide_enough_to_leak(name: str):
    """Leave no point farther than spacing/√2 from a ghost on its own side."""
    mesh = SHAPES[name]
    ghosts = rasterize_ghosts(mesh.vertices, mesh.faces, SPACING)
    place = ghosts.positions(mesh.vertices, mesh.faces)
    normal = ghosts.normals(mesh.vertices, mesh.faces)
    samples, faces = trimesh.sample.sample_surface(mesh, 3000, seed=1)
    apart = np.linalg.norm(samples[:, None] - place[None], axis=2)
    same_side = mesh.face_normals[faces] @ normal.T > 0.4
    assert np.where(same_side, apart, np.inf).min(1).max() < SPACING / np.sqrt(2)


@pytest.mark.parametrize("name", SHAPES)
def test_areas_sum_up_and_normals_point_outward(name: str):
    """Divide the whole surface among ghosts, with normals that point away from the center."""
    mesh = SHAPES[name]
    ghosts = rasterize_ghosts(mesh.vertices, mesh.faces, SPACING)
    assert ghosts.area.sum() == pytest.approx(mesh.area, rel=1e-9)
    assert ghosts.area.min() > 0
    place = ghosts.positions(mesh.vertices, mesh.faces)
    normal = ghosts.normals(mesh.vertices, mesh.faces)
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0)
    assert ((place - mesh.center_mass) * normal).sum(1).min() > 0


def test_there_are_no_more_than_needed():
    """Use about two ghosts per squared spacing."""
    mesh = SHAPES["box"]
    count = len(rasterize_ghosts(mesh.vertices, mesh.faces, SPACING).face)
    assert mesh.area / SPACING**2 < count < 3 * mesh.area / SPACING**2


def test_ghosts_are_reproducible():
    """Give the same ghosts each time."""
    mesh = SHAPES["ball"]
    first = rasterize_ghosts(mesh.vertices, mesh.faces, SPACING)
    second = rasterize_ghosts(mesh.vertices, mesh.faces, SPACING)
    np.testing.assert_array_equal(first.face, second.face)
    np.testing.assert_array_equal(first.weights, second.weights)


def test_ghosts_follow_a_deforming_mesh():
    """Move ghosts on the device with their triangles, including normals, motion and orientation."""
    mesh = SHAPES["ball"]
    ghosts = rasterize_ghosts(mesh.vertices, mesh.faces, SPACING)
    stretched = mesh.vertices * (1.5, 1.0, 0.7) + (0.0, 0.1, 0.0)
    motion = np.tile((0.001, 0.0, 0.002), (len(stretched), 1))
    device = wp.get_device("cpu")
    on_device = GhostMesh(ghosts, 0.01, device)
    shape = wp.Mesh(
        wp.array(stretched, dtype=wp.vec3, device=device),
        wp.array(mesh.faces.ravel(), dtype=int, device=device),
        wp.array(motion, dtype=wp.vec3, device=device),
    )
    on_device.carry(shape, wp.array([1.0, -1.0], dtype=float, device=device), 0)
    expected = ghosts.positions(stretched, mesh.faces)
    np.testing.assert_allclose(on_device.position.numpy(), expected, atol=1e-7)
    normal = ghosts.normals(stretched, mesh.faces)
    np.testing.assert_allclose(on_device.normal.numpy(), normal, atol=1e-4)
    np.testing.assert_allclose(on_device.drift.numpy(), motion[: on_device.count], atol=1e-9)
    on_device.carry(shape, wp.array([1.0, -1.0], dtype=float, device=device), 1)
    np.testing.assert_allclose(on_device.normal.numpy(), -normal, atol=1e-4)


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan")])
def test_invalid_spacing_is_refused(spacing: float):
    """Refuse a spacing that is not a positive number."""
    mesh = SHAPES["box"]
    with pytest.raises(ValueError, match="above 0"):
        rasterize_ghosts(mesh.vertices, mesh.faces, spacing)
