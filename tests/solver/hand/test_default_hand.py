# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand as a skinned mesh: OpenXR's bones, smooth weights, plausible poses."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_clay.solver.geometry.skin_query import SkinQuery
from tactile_clay.solver.hand.default_hand import default_hand, default_hand_rig
from tactile_clay.solver.hand.proportions import AVERAGE, JOINT_NAMES
from tactile_clay.solver.hand.shape import hand_shape
from tactile_clay.solver.hand.skinned_hand import SkinnedHand

from .hand_poses import FIST, pose_bones


def scaled(values: tuple[float, ...], factor: float) -> Any:
    """A tuple with every value scaled."""
    return tuple(factor * value for value in values)


@pytest.fixture(scope="module")
def hand() -> SkinnedHand:
    return default_hand()


def test_bones_are_the_joints_of_openxr(hand: SkinnedHand) -> None:
    """Have all 26 joints, with the wrist first and parents before children."""
    assert sorted(hand.bone_names) == sorted(JOINT_NAMES)
    assert hand.bone_names[0] == "wrist"
    assert (hand.bone_parent < np.arange(26)).all()
    parents = {
        name: hand.bone_names[parent] if parent >= 0 else None
        for name, parent in zip(hand.bone_names, hand.bone_parent, strict=True)
    }
    assert parents["index_tip"] == "index_distal"
    assert parents["thumb_metacarpal"] == parents["little_metacarpal"] == "wrist"
    assert [name for name, parent in parents.items() if parent is None] == ["wrist"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_axes_follow_openxr(side: str) -> None:
    """Point -Z along each finger bone, and +Y out of the back of the hand."""
    hand = default_hand(side)
    heads = {n: m[:3, 3] for n, m in zip(hand.bone_names, hand.bone_rest, strict=True)}
    for name, matrix, parent in zip(hand.bone_names, hand.bone_rest, hand.bone_parent, strict=True):
        np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
        if parent > 0:
            before = hand.bone_rest[parent]
            bone = heads[name] - heads[hand.bone_names[parent]]
            np.testing.assert_allclose(-before[:3, 2], bone / np.linalg.norm(bone), atol=1e-9)
        if not name.startswith("thumb"):
            assert matrix[2, 1] > 0.85


def test_skin_is_closed_and_has_at_most_four_bones_per_vertex(hand: SkinnedHand) -> None:
    """Have a closed skin with normalized weights, and fingertips with weights of their finger."""
    mesh = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    assert mesh.is_watertight and mesh.volume > 300e-6
    np.testing.assert_allclose(hand.weights.sum(1), 1.0)
    assert (hand.weights >= 0.0).all()
    assert (hand.weights > 0.0).sum(1).max() <= 4
    for finger in ("thumb", "index", "middle", "ring", "little"):
        own = [name.startswith(finger) for name in hand.bone_names]
        end = hand.weights[:, [name == f"{finger}_distal" for name in hand.bone_names]][:, 0] > 0.5
        assert end.sum() > 50
        np.testing.assert_allclose(hand.weights[end][:, own].sum(1), 1.0)


def test_weights_change_smoothly_along_the_skin(hand: SkinnedHand) -> None:
    """Have no jumps of weights between neighboring vertices."""
    edges = np.unique(np.sort(hand.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    steps = np.abs(hand.weights[edges[:, 0]] - hand.weights[edges[:, 1]]).sum(1)
    assert np.percentile(steps, 99) < 0.6
    assert steps.max() < 1.0


@pytest.mark.parametrize("pose", ["flat", "relaxed", "point", "pinch"])
def test_posed_skin_keeps_its_volume_and_depth(hand: SkinnedHand, pose: str) -> None:
    """Keep the volume to 4 %, and the joints about their radius below the skin."""
    posed = trimesh.Trimesh(hand.posed(pose_bones(pose)), hand.faces, process=False)
    rest = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    assert posed.volume == pytest.approx(rest.volume, rel=0.04)
    shape = hand_shape(pose=pose)
    names = [name for name in JOINT_NAMES if name.endswith(("intermediate", "distal", "tip"))]
    joints = np.array([shape.joints[name] for name in names])
    radii = np.array([shape.radii[name] for name in names])
    depth = trimesh.proximity.closest_point_naive(posed, joints)[1]
    assert np.all(depth > 0.65 * radii)


def test_fist_keeps_its_volume(hand: SkinnedHand) -> None:
    """Lose less than 8 % of the volume in a fist, the hardest pose for linear skinning."""
    fist = trimesh.Trimesh(hand.posed(pose_bones(FIST)), hand.faces, process=False)
    rest = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    assert 0.92 < fist.volume / rest.volume < 1.05


@pytest.mark.parametrize("thickness", [0.7, 1.0, 1.35])
def test_thick_and_thin_fingers_stay_apart(thickness: float) -> None:
    """Have a closed skin with gaps between fingers of any thickness."""
    fingers = {
        name: finger._replace(radii=scaled(finger.radii, thickness))
        for name, finger in AVERAGE.fingers.items()
    }
    hand = default_hand(proportions=replace(AVERAGE, fingers=fingers))
    mesh = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    heads = dict(zip(hand.bone_names, hand.bone_rest[:, :3, 3], strict=True))
    skin = SkinQuery(hand.vertices, hand.faces)
    for first, second in pairwise(("index", "middle", "ring", "little")):
        for segment in ("intermediate", "distal"):
            line = np.linspace(heads[f"{first}_{segment}"], heads[f"{second}_{segment}"], 200)
            assert (skin.nearest(line).depth < 0.0).any()


def test_rig_of_the_default_hand_is_created_in_one_call() -> None:
    """Create and bind a hand for a particle spacing."""
    rig = default_hand_rig("left", clay_spacing=0.01, length=0.15)
    assert rig.side == "left" and len(rig.bone_names) == 26
    assert rig.ghost_spacing == pytest.approx(0.005)
    assert 350 < len(rig.nodes) < 700
