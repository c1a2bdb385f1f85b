# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene accepts and what it refuses."""

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, MeshError, Scene


def test_clay_is_kept_in_the_order_added():
    """Concatenate bodies, colors and materials in order."""
    scene = Scene(0.01)
    soft, stiff = Material(yield_stress=1e3), Material(yield_stress=1e4)
    first = scene.add_clay(np.zeros((2, 3)), soft, colors=(1, 0, 0, 1))
    second = scene.add_clay(np.ones((3, 3)), stiff, velocities=(0, 0, 1))
    third = scene.add_clay(np.ones((1, 3)), soft)
    assert (first.start, second.start, third.start) == (0, 2, 5)
    assert scene.particle_count == 6
    materials, indices = scene.materials()
    assert materials == [soft, stiff]
    assert indices.tolist() == [0, 0, 1, 1, 1, 0]
    assert scene.colors()[0].tolist() == [1, 0, 0, 1]
    assert scene.initial_velocities()[2].tolist() == [0, 0, 1]


def test_bad_clay_is_refused():
    """Count points that are not finite; refuse colors of another length."""
    scene = Scene(0.01)
    points = np.zeros((4, 3))
    points[1, 0] = np.inf
    with pytest.raises(ValueError, match="1 of 4"):
        scene.add_clay(points, Material())
    with pytest.raises(ValueError, match="colors"):
        scene.add_clay(np.zeros((4, 3)), Material(), colors=np.zeros((3, 4)))
    with pytest.raises(ValueError, match="shape"):
        scene.add_clay(np.zeros((3, 2)), Material())
    assert scene.particle_count == 0


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan")])
def test_bad_spacing_is_refused(spacing: float):
    """Refuse a spacing that is not above zero."""
    with pytest.raises(ValueError, match="spacing"):
        Scene(spacing)


def test_bad_collider_is_refused():
    """Refuse an open tool, a plane without direction and negative friction."""
    scene = Scene()
    box = trimesh.creation.box()
    with pytest.raises(MeshError, match="hole"):
        scene.add_mesh(box.vertices, box.faces[:-1])
    with pytest.raises(ValueError, match="normal"):
        scene.add_plane((0, 0, 0), (0, 0, 0))
    with pytest.raises(ValueError, match="friction"):
        scene.add_plane(friction=-1.0)


def test_bad_pose_keeps_the_last_good_one():
    """Refuse a pose that is flat or not finite, and keep the last one."""
    box = trimesh.creation.box()
    tool = Scene().add_mesh(box.vertices, box.faces)
    good = np.diag([2.0, 1.0, 1.0, 1.0])
    tool.set_pose(good)
    bad = good.copy()
    bad[0, 3] = np.nan
    for pose, text in ((bad, "finite"), (np.diag([1.0, 1, 0, 1]), "flat"), (np.eye(3), "4x4")):
        with pytest.raises(ValueError, match=text):
            tool.set_pose(pose)
        np.testing.assert_array_equal(tool.pose, good)
    with pytest.raises(ValueError, match="8 vertices"):
        tool.set_vertices(np.zeros((7, 3)))
