# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses of the default hand shared by tests."""

from dataclasses import fields

import numpy as np

from tactile_clay.solver.hand.default_hand import bone_matrices
from tactile_clay.solver.hand.shape import POSES, HandPose, hand_shape

FIST = HandPose(
    index=(-1.0, 78.0, 100.0, 55.0),
    middle=(0.0, 82.0, 102.0, 55.0),
    ring=(1.0, 84.0, 102.0, 55.0),
    little=(3.0, 84.0, 98.0, 52.0),
    thumb=(34.0, 0.0, 46.0, 34.0, 40.0),
)
"""All fingers fully curled."""


def curled(share: float) -> HandPose:
    """A pose between the flat hand, at 0, and the fist, at 1."""
    return HandPose(
        **{
            field.name: tuple(
                (1.0 - share) * np.array(getattr(POSES["flat"], field.name))
                + share * np.array(getattr(FIST, field.name))
            )
            for field in fields(HandPose)
        }
    )


def pose_bones(pose: str | HandPose) -> dict[str, np.ndarray]:
    """Bone matrices of a right hand in a pose, bone to world, by bone name."""
    return bone_matrices(hand_shape(pose=pose))
