# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand's mesh: closed, with human proportions, and consistent with its joints."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_clay.solver.hand.mesh import hand_mesh
from tactile_clay.solver.hand.proportions import JOINT_NAMES
from tactile_clay.solver.hand.shape import POSES, HandPose, hand_shape


def mesh_of(**options: Any) -> trimesh.Trimesh:
    vertices, faces = hand_mesh(**options)
    return trimesh.Trimesh(vertices, faces, process=False)


def winding(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Winding numbers: 1 inside, 0 outside."""
    a, b, c = np.moveaxis(mesh.triangles[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=-1) for corner in (a, b, c))
    above = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    dots = [np.einsum("ijk,ijk->ij", first, second) for first, second in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.round(np.arctan2(above, below).sum(axis=1) / (2.0 * np.pi))


def body_count(faces: np.ndarray) -> int:
    """Number of connected pieces; trimesh's own count needs a graph library."""
    label = np.arange(faces.max() + 1)
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, faces, label[faces].min(axis=1, keepdims=True))
        if np.array_equal(lowest, label):
            return len(np.unique(label[faces]))
        label = lowest


@pytest.fixture(scope="module", params=list(POSES))
def pose(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def hand(pose: str) -> trimesh.Trimesh:
    return mesh_of(pose=pose)


def test_hand_is_one_closed_body(hand: trimesh.Trimesh) -> None:
    """Have a closed skin in one piece, with normals that point outwards."""
    assert hand.is_watertight
    assert hand.is_winding_consistent
    assert body_count(hand.faces) == 1
    assert hand.volume > 0.0


def test_volume_is_that_of_an_adult_hand(hand: trimesh.Trimesh) -> None:
    """Have an adult hand's volume, including the wrist stub, in any pose."""
    assert 300e-6 < hand.volume < 450e-6


def test_triangles_are_even(hand: trimesh.Trimesh) -> None:
    """Have triangles of a few millimeters without slivers."""
    edges = hand.edges_unique_length
    assert len(hand.faces) < 9000
    assert 0.003 < edges.mean() < 0.0045
    assert np.percentile(np.degrees(hand.face_angles), 1) > 30.0
    assert hand.face_angles.min() > np.radians(1.0)


def test_joints_lie_inside(pose: str, hand: trimesh.Trimesh) -> None:
    """Have all 26 joints below the skin, at a depth of about their radius."""
    shape = hand_shape(pose=pose)
    assert tuple(shape.joints) == JOINT_NAMES and len(JOINT_NAMES) == 26
    points = np.array(list(shape.joints.values()))
    depth = trimesh.proximity.closest_point_naive(hand, points)[1]
    assert np.all(winding(hand, points) == 1)
    radii = np.array(list(shape.radii.values()))
    fingers = np.array([name.endswith(("intermediate", "distal", "tip")) for name in JOINT_NAMES])
    assert np.all(depth > 0.5 * radii)
    np.testing.assert_allclose(depth[fingers], radii[fingers], atol=0.0018)


def test_axes_of_joints_point_along_the_bones() -> None:
    """Point the Y axis of each finger joint to the next joint."""
    shape = hand_shape("left", pose="relaxed")
    for name in ("index", "little"):
        start, end = shape.joints[f"{name}_intermediate"], shape.joints[f"{name}_distal"]
        along = (end - start) / np.linalg.norm(end - start)
        np.testing.assert_allclose(shape.axes[f"{name}_intermediate"][:, 1], along, atol=1e-9)
        assert np.linalg.det(shape.axes[f"{name}_intermediate"]) == pytest.approx(1.0)


def test_left_is_the_mirror_image_of_right(hand: trimesh.Trimesh, pose: str) -> None:
    """Mirror the hand and its joints in X, without turning it inside out."""
    left = mesh_of(side="left", pose=pose)
    np.testing.assert_array_equal(left.vertices, hand.vertices * (-1.0, 1.0, 1.0))
    assert left.volume == pytest.approx(hand.volume)
    for name, joint in hand_shape("left", pose=pose).joints.items():
        np.testing.assert_array_equal(joint, hand_shape(pose=pose).joints[name] * (-1, 1, 1))


def test_length_scales_everything() -> None:
    """Scale the hand uniformly to another length."""
    adult, child = mesh_of(), mesh_of(length=0.12)
    np.testing.assert_allclose(child.vertices, adult.vertices * (0.12 / 0.19))
    np.testing.assert_array_equal(child.faces, adult.faces)
    assert hand_shape(length=0.12).radii["palm"] == pytest.approx(
        hand_shape().radii["palm"] * 0.12 / 0.19
    )


def test_length_runs_from_wrist_to_middle_fingertip() -> None:
    """Reach the given length with the straight middle finger."""
    straight = HandPose()
    assert mesh_of(pose=straight).bounds[1, 1] == pytest.approx(0.19, abs=0.001)


def test_flat_fingers_stay_apart() -> None:
    """Have gaps between neighboring fingers beyond a third of their length."""
    hand, shape = mesh_of(pose="flat"), hand_shape(pose="flat")
    for first, second in (("index", "middle"), ("middle", "ring"), ("ring", "little")):
        for segment in ("intermediate", "distal"):
            between = 0.5 * (
                shape.joints[f"{first}_{segment}"] + shape.joints[f"{second}_{segment}"]
            )
            assert winding(hand, between[None])[0] == 0


def test_pinch_brings_thumb_and_index_together() -> None:
    """Bring the two tips within a few millimeters without fusing them."""
    hand, shape = mesh_of(pose="pinch"), hand_shape(pose="pinch")
    thumb, index = shape.joints["thumb_tip"], shape.joints["index_tip"]
    between = thumb + np.linspace(0.0, 1.0, 200)[:, None] * (index - thumb)
    gap = np.mean(winding(hand, between) == 0) * np.linalg.norm(index - thumb)
    assert 0.002 < gap < 0.014


def test_thumb_is_on_the_inner_side() -> None:
    """Have a right hand's thumb at -X when its palm faces down, and bend fingers to the palm."""
    assert hand_shape().joints["thumb_tip"][0] < -0.05
    assert hand_shape(pose="relaxed").joints["middle_tip"][2] < -0.02


def test_any_joint_angles_give_a_closed_hand() -> None:
    """Mesh fingers that touch each other and the palm."""
    fist = replace(
        POSES["flat"],
        index=(0.0, 85.0, 105.0, 60.0),
        middle=(0.0, 85.0, 105.0, 60.0),
        ring=(0.0, 85.0, 105.0, 60.0),
        little=(0.0, 85.0, 105.0, 60.0),
        thumb=(40.0, 10.0, 40.0, 40.0, 50.0),
    )
    hand = mesh_of(pose=fist)
    assert hand.is_watertight and hand.volume > 300e-6


@pytest.mark.parametrize("edge_length", [0.003, 0.005])
def test_edge_length_sets_the_triangles(edge_length: float) -> None:
    """Have triangles of the given edge length."""
    hand = mesh_of(edge_length=edge_length)
    assert hand.is_watertight
    assert hand.edges_unique_length.mean() == pytest.approx(edge_length, rel=0.2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"side": "middle"}, '"right" or "left"'),
        ({"length": 0.0}, "positive"),
        ({"length": float("nan")}, "positive"),
        ({"pose": "wave"}, "flat, relaxed, point, pinch"),
        ({"edge_length": 0.02}, "between"),
    ],
)
def test_invalid_input_is_refused(options: dict, words: str) -> None:
    """Say what is wrong and what is allowed."""
    with pytest.raises(ValueError, match=words):
        hand_mesh(**options)
