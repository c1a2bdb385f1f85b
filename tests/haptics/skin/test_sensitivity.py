# SPDX-License-Identifier: GPL-3.0-or-later
"""Perceptual weights: pads are found on any hand, and weights follow receptor densities."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tactile_clay.haptics.skin.finger_pads import find_finger_pads
from tactile_clay.haptics.skin.sensitivity import ReceptorDensity, SkinSensitivity, _interpolated
from tactile_clay.solver.hand.bone_names import FINGER_WORDS
from tactile_clay.tests.haptics.hands import bare_rig, hand_shape

FINGERS = ("thumb", "index", "middle", "ring", "little")


def webxr(name: str) -> str:
    """WebXR's name for a joint of OpenXR."""
    finger, _, segment = name.partition("_")
    if segment in ("", "tip"):
        return name.replace("_", "-")
    if segment == "metacarpal":
        return f"{finger}-metacarpal"
    return f"{finger}-finger-phalanx-{segment}"


def rigify(name: str) -> str:
    """Rigify's name, in a right hand."""
    if "_" not in name:
        return {"wrist": "hand.R", "palm": "palm.R"}[name]
    finger, _, segment = name.partition("_")
    number = ("metacarpal", "proximal", "intermediate", "distal", "tip").index(segment)
    prefix = "" if finger == "thumb" else "f_"
    return f"{prefix}{finger.replace('little', 'pinky')}.{number:02d}.R"


def mixamo(name: str) -> str:
    """Mixamo's name, in a left hand."""
    if "_" not in name:
        return "mixamorig:LeftHand" if name == "wrist" else "mixamorig:LeftForeArm"
    finger, _, segment = name.partition("_")
    number = ("metacarpal", "proximal", "intermediate", "distal", "tip").index(segment)
    return f"mixamorig:LeftHand{finger.replace('little', 'pinky').title()}{number}"


@pytest.mark.parametrize(
    ("options", "pose"),
    [
        ({"side": "right"}, "flat"),
        ({"side": "left", "named": webxr}, "relaxed"),
        ({"side": "right", "named": rigify, "told_side": ""}, "relaxed"),
        ({"side": "left", "named": mixamo, "told_side": "", "tips": False}, "relaxed"),
        ({"side": "right", "told_side": "", "length": 0.13}, "flat"),
        ({"side": "right"}, "pinch"),
    ],
)
def test_pads_are_found_by_names_and_shape(options, pose):
    """Find all five pads on the palm side of the fingertips, with any naming of bones."""
    rig = bare_rig(pose=pose, **options)
    pads = find_finger_pads(rig)
    assert pads.fingers == FINGERS
    shape = hand_shape(options["side"], length=options.get("length", 0.19), pose=pose)
    chosen = rig.vertices[pads.vertices]
    scale = options.get("length", 0.19) / 0.19
    middles = [0.5 * (shape.joints[f"{f}_tip"] + shape.joints[f"{f}_distal"]) for f in FINGERS]
    distance = np.linalg.norm(chosen[:, None] - np.array(middles), axis=2)
    assert distance.min(1).max() < 0.025 * scale
    for finger, middle, own in zip(
        FINGERS, middles, np.arange(5)[:, None] == distance.argmin(1), strict=True
    ):
        assert own.sum() > 8
        below = -((chosen[own] - middle) @ shape.axes[f"{finger}_tip"][:, 2])
        # If the thumb is bent when bound, its pad is found rotated by up to 45 degrees.
        assert np.mean(below > 0.0) > (0.7 if finger == "thumb" else 0.95)
    assert pads.finger_length == pytest.approx(0.0628 * scale, rel=0.03)


SPOKEN = [
    *((FINGERS[index], word) for word, index in FINGER_WORDS.items()),
    *(("thumb", word) for word in ("pollex", "親指")),
    *(("index", word) for word in ("pointer", "forefinger", "人指", "人差指")),
    *(("middle", word) for word in ("中指",)),
    *(("ring", word) for word in ("薬指",)),
    *(("little", word) for word in ("pinkfinger", "small", "小指")),
]


@pytest.mark.parametrize(("finger", "word"), SPOKEN)
@pytest.mark.parametrize("written", [str, str.upper, str.title])
def test_a_finger_is_found_by_each_word_for_it(finger, word, written):
    """Find the same pads by each word that the rest of Tactile Clay knows, and by others."""
    rig = bare_rig(named=lambda name: written(name.replace(finger, word)))
    pads = find_finger_pads(rig)
    assert pads.fingers == FINGERS
    assert np.array_equal(pads.vertices, find_finger_pads(bare_rig()).vertices)


def test_the_other_hand_of_a_body_is_ignored():
    """Find the pads of a right hand in a skeleton with both hands."""
    rig = bare_rig("right", named=lambda name: f"{name}.R")
    rest = np.concatenate([rig.bone_rest, rig.bone_rest])
    rest[len(rig.bone_rest) :, 0, 3] += 0.8
    both = replace(
        rig,
        bone_names=(*rig.bone_names, *(name[:-1] + "L" for name in rig.bone_names)),
        bone_rest=rest,
        bone_parent=np.concatenate([rig.bone_parent, rig.bone_parent]),
    )
    assert np.array_equal(find_finger_pads(both).vertices, find_finger_pads(rig).vertices)


def test_a_hand_without_fingers_is_refused():
    """Say which names are understood if no bone is named after a finger."""
    rig = bare_rig(named=lambda name: "bone" + str(abs(hash(name))))
    with pytest.raises(ValueError, match="thumb, index, middle"):
        find_finger_pads(rig)


def test_weights_are_one_at_the_pads_and_fall_along_the_skin():
    """Give pads weight 1, the palm its relative receptor density, decreasing with distance."""
    rig = bare_rig()
    skin = SkinSensitivity.of(rig)
    assert (skin.vertices[skin.pads.vertices] == 1.0).all()
    order = np.argsort(skin.distances)
    assert (np.diff(skin.vertices[order]) <= 0.0).all()
    palm = np.linalg.norm(rig.vertices[:, :2] - (0.0, 0.05), axis=1) < 0.02
    assert np.allclose(skin.vertices[palm], 58.0 / 241.0, atol=0.01)
    # The ghosts of this rig are at the vertices.
    assert np.allclose(skin.ghosts, skin.vertices)


def test_distances_go_along_the_skin_not_through_the_finger():
    """Reach a nail around the finger, not through the bone."""
    rig = bare_rig(pose="flat")
    skin = SkinSensitivity.of(rig)
    straight = np.linalg.norm(
        rig.vertices[:, None] - rig.vertices[skin.pads.vertices][None], axis=2
    ).min(1)
    # The straight line may start at a vertex inside the pad, so allow 1 mm.
    assert (skin.distances > straight - 0.001).all()
    assert (skin.distances > 1.25 * straight).sum() > 20


def test_left_and_right_mirror_each_other():
    """Give a left hand the mirrored weights of a right hand."""
    right, left = bare_rig("right"), bare_rig("left")
    assert np.allclose(right.vertices * (-1, 1, 1), left.vertices)
    assert np.allclose(SkinSensitivity.of(right).vertices, SkinSensitivity.of(left).vertices)


def test_mean_over_a_finger_is_its_density():
    """Average to the finger's receptor density relative to the fingertip."""
    density = ReceptorDensity.preset()
    assert (density.fingertip, density.finger, density.palm) == (241.0, 93.0, 58.0)
    distances = (np.arange(100_000) + 0.5) / 100_000 * 0.063
    assert density.weights(distances, 0.063).mean() == pytest.approx(93.0 / 241.0, rel=1e-6)
    near, far = density.weights([0.0, np.inf], 0.063)
    assert (near, far) == (1.0, pytest.approx(58.0 / 241.0))


def test_densities_that_do_not_decrease_are_refused():
    """Refuse a palm that is more sensitive than a finger."""
    with pytest.raises(ValueError, match=re.escape("decrease from fingertip")):
        ReceptorDensity(fingertip=241.0, finger=50.0, palm=58.0)


def test_values_are_interpolated_between_vertices():
    """Interpolate a linear function exactly on triangles, and at their edges."""
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.0), (9, 9, 9)])
    faces = np.array([(0, 1, 2), (1, 3, 2)])
    points = np.array([(0.25, 0.25, 0.1), (0.8, 0.7, -0.2), (0.5, -0.3, 0.0)])
    found = _interpolated(vertices, faces, vertices @ (2.0, 3.0, 0.0), points)
    assert np.allclose(found, [1.25, 3.7, 1.0])
