# SPDX-License-Identifier: GPL-3.0-or-later
"""Parents of loose bones, by name."""

import numpy as np
import pytest

from tactile_clay.solver.hand.bone_names import named_parents
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
OPENXR = tuple(f"XR_HAND_JOINT_{name.upper()}_EXT" for name in BONE_NAMES if name != "palm")


def test_names_of_webxr_and_openxr_give_chains() -> None:
    """Parent each bone to the previous one, and the metacarpals and the palm to the wrist."""
    assert "index-finger-phalanx-proximal" in WEBXR and "thumb-tip" in WEBXR
    np.testing.assert_array_equal(named_parents(BONE_NAMES), bone_parents())
    np.testing.assert_array_equal(named_parents(WEBXR), bone_parents())
    shuffled = np.random.default_rng(1).permutation(len(OPENXR))
    names = tuple(OPENXR[bone] for bone in shuffled)
    parents = named_parents(names)
    chain = {name: names[p] if p >= 0 else None for name, p in zip(names, parents, strict=True)}
    assert chain["XR_HAND_JOINT_RING_TIP_EXT"] == "XR_HAND_JOINT_RING_DISTAL_EXT"
    assert chain["XR_HAND_JOINT_THUMB_METACARPAL_EXT"] == "XR_HAND_JOINT_WRIST_EXT"
    assert chain["XR_HAND_JOINT_WRIST_EXT"] is None


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
