# SPDX-License-Identifier: GPL-3.0-or-later
"""Parents of loose bones, by name."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.solver.hand.bone_names import named_parents
from tactile_clay.solver.hand.proportions import JOINT_NAMES
from tactile_clay.solver.hand.weights import BONE_NAMES, bone_parents

WEBXR = tuple(
    name
    if name in ("wrist", "palm")
    else (
        name.replace("thumb_", "thumb-")
        if name.startswith("thumb") and name.endswith(("metacarpal", "tip"))
        else name.replace("thumb_", "thumb-phalanx-")
        if name.startswith("thumb")
        else name.replace("_metacarpal", "-finger-metacarpal")
        .replace("_tip", "-finger-tip")
        .replace("_", "-finger-phalanx-")
        .replace("little", "pinky")
    )
    for name in BONE_NAMES
)
OPENXR = tuple(f"XR_HAND_JOINT_{name.upper()}_EXT" for name in JOINT_NAMES)
FINGERS = ("thumb", "index", "middle", "ring", "little")
NUMBERED = ("thumb", "index", "middle", "ring", "pinky")


def chained(names: tuple[str, ...]) -> dict[str, str]:
    """The name of each bone's parent by its own name, empty for a root."""
    parents = named_parents(names)
    return {name: names[p] if p >= 0 else "" for name, p in zip(names, parents, strict=True)}


def openxr_parents() -> dict[str, str]:
    """What `chained` should give for OpenXR's short names."""
    wanted = {"wrist": "", "palm": "wrist"}
    for finger in FINGERS:
        before = "wrist"
        for name in JOINT_NAMES:
            if name.startswith(finger):
                wanted[name], before = before, name
    return wanted


def test_names_of_webxr_and_openxr_give_chains() -> None:
    """Parent each bone to the previous one, and the metacarpals and the palm to the wrist."""
    assert "index-finger-phalanx-proximal" in WEBXR and "thumb-tip" in WEBXR
    np.testing.assert_array_equal(named_parents(BONE_NAMES), bone_parents())
    np.testing.assert_array_equal(named_parents(WEBXR), bone_parents())
    chain = chained(OPENXR)
    assert chain["XR_HAND_JOINT_RING_TIP_EXT"] == "XR_HAND_JOINT_RING_DISTAL_EXT"
    assert chain["XR_HAND_JOINT_THUMB_METACARPAL_EXT"] == "XR_HAND_JOINT_WRIST_EXT"
    assert chain["XR_HAND_JOINT_PALM_EXT"] == "XR_HAND_JOINT_WRIST_EXT"
    assert chain["XR_HAND_JOINT_WRIST_EXT"] == ""


PREFIXES = ("", "XR_HAND_JOINT_", "Left_XR_HAND_JOINT_", "hand_r_", "RightHand:", "Hand.L|", "b_l_")
SUFFIXES = ("", "_EXT", ".L", "_R", "_EXT.001", " right", "_joint_hand")


@given(
    st.sampled_from(PREFIXES),
    st.sampled_from(SUFFIXES),
    st.sampled_from((str, str.upper, str.title)),
    st.permutations(JOINT_NAMES),
)
def test_all_joints_of_openxr_are_chained(prefix, suffix, written, order) -> None:
    """Chain all 26 joints, however they are decorated, written and sorted."""
    assert len(order) == 26

    def full(name: str) -> str:
        return f"{prefix}{written(name)}{suffix}" if name else ""

    names = tuple(full(name) for name in order)
    wanted = {full(name): full(parent) for name, parent in openxr_parents().items()}
    assert chained(names) == wanted


def test_a_forearm_is_no_second_wrist() -> None:
    """Leave the elbow that some runtimes add a root, and chain the others."""
    elbow = "XR_HAND_FOREARM_JOINT_ELBOW_ULTRALEAP"
    assert chained((elbow, *OPENXR)) == {elbow: "", **chained(OPENXR)}


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_names_of_leap_are_chained(side: str) -> None:
    """Chain the bones that Leap's library names, with and without the palm."""
    segments = ("metacarpal", "proximal", "intermediate", "distal")
    for palm in ((), (f"{side}_Palm",)):
        names = [f"{side}_Wrist", *palm]
        wanted = {f"{side}_Wrist": "", **dict.fromkeys(palm, f"{side}_Wrist")}
        for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky"):
            before = f"{side}_Wrist"
            for segment in segments:
                names.append(f"{side}_{finger}_{segment}")
                wanted[names[-1]] = before
                before = names[-1]
        assert chained(tuple(names)) == wanted


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    "thumb",
    [("Proximal", "Intermediate", "Distal"), ("Metacarpal", "Proximal", "Distal")],
    ids=["VRM 0", "VRM 1"],
)
def test_names_of_vrm_are_chained(side: str, thumb: tuple[str, ...]) -> None:
    """Chain the humanoid bones of VRM, whose hand is written in one word with its side."""
    names, wanted = [f"{side}LowerArm", f"{side}Hand"], {f"{side}LowerArm": "", f"{side}Hand": ""}
    for finger in ("Thumb", "Index", "Middle", "Ring", "Little"):
        before = f"{side}Hand"
        for segment in thumb if finger == "Thumb" else ("Proximal", "Intermediate", "Distal"):
            names.append(f"{side}{finger}{segment}")
            wanted[names[-1]] = before
            before = names[-1]
    assert chained(tuple(names)) == wanted


@pytest.mark.parametrize("side", ["left", "right"])
def test_numbered_fingers_stay_loose(side: str) -> None:
    """Guess nothing from the numbers of Mixamo, MANO, VRoid and Rigify; palms follow the hand."""
    title, letter = side.title(), side[0].upper()
    mixamo = (
        f"mixamorig:{title}ForeArm",
        f"mixamorig:{title}Hand",
        *(f"mixamorig:{title}Hand{f.title()}{n}" for f in NUMBERED for n in (1, 2, 3, 4)),
    )
    mano = (f"{side}_wrist", *(f"{side}_{f}{n}" for f in NUMBERED for n in (1, 2, 3)))
    vroid = (
        f"J_Bip_{letter}_Hand",
        *(f"J_Bip_{letter}_{f.title()}{n}" for f in FINGERS for n in (1, 2, 3)),
    )
    for names in (mixamo, mano, vroid):
        assert set(chained(names).values()) == {""}
    palms = tuple(f"DEF-palm.{n:02d}.{letter}" for n in (1, 2, 3, 4))
    rigify = (
        f"DEF-forearm.{letter}",
        f"DEF-hand.{letter}",
        *palms,
        *(f"DEF-thumb.{n:02d}.{letter}" for n in (1, 2, 3)),
        *(f"DEF-f_{f}.{n:02d}.{letter}" for f in NUMBERED[1:] for n in (1, 2, 3)),
    )
    chain = chained(rigify)
    assert {name for name, parent in chain.items() if parent} == set(palms)
    assert {chain[palm] for palm in palms} == {f"DEF-hand.{letter}"}


def test_missing_bones_are_skipped() -> None:
    """Parent a finger without a metacarpal to the wrist."""
    names = ("hand.R", "index_proximal.R", "index_distal.R")
    np.testing.assert_array_equal(named_parents(names), [-1, 0, 1])


@pytest.mark.parametrize(
    "names",
    [
        ("Bone", "Bone.001", "Bone.002"),
        ("wrist", "hand", "index_distal"),
        ("wrist", "index_tip", "old_index_tip"),
        (),
    ],
    ids=["meaningless", "two wrists", "twice", "none"],
)
def test_unknown_names_stay_loose(names: tuple[str, ...]) -> None:
    """Find no parents if the names are unknown or ambiguous."""
    assert (named_parents(names) < 0).all()
