# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the flesh that the clay meets lies from the hand that one sees."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...solver.hand.rig import HandRig
from ...solver.soft_hand.bones import posed_skin
from ..base.mesh_geometry import evaluated_mesh, transform, world_matrix
from ..base.units import to_meters
from .hand import hand_bone_matrices
from .reading import HandError

MAX_GAP = 0.025
"""Flesh farther than this from the shown skin is a fault, over the length of the hand. A fist has
two thirds of it: Blender's skinning pinches the joints, and flesh does not."""


@dataclass(frozen=True)
class SkinGap:
    """The largest distance between a hand's flesh and the mesh that is shown."""

    meters: float
    """The distance [m]."""
    frame: int
    """The frame it was measured at."""
    length: float
    """The hand's length [m]."""

    @property
    def too_large(self) -> bool:
        """Whether a person would see that the clay does not meet the shown hand."""
        return self.meters > MAX_GAP * self.length

    def warning(self, name: str) -> str:
        """What a person should know and do."""
        return (
            f"The flesh of {name!r} lies up to {self.meters * 1e3:.2g} mm beside the mesh that is "
            f"shown at frame {self.frame}, so the clay does not meet the hand that one sees. Only "
            "the armature's bones carry flesh: apply or switch off other deforming modifiers and "
            "shape keys, bone envelopes and vertex groups of the Armature modifier, then press "
            "Make Clay Hand again."
        )


def skin_gap(
    item: bpy.types.Object, rig: HandRig, depsgraph: bpy.types.Depsgraph
) -> SkinGap | None:
    """Measure a clay hand at the current frame; None where nothing of it is shown.

    Args:
        item: The hand's mesh.
        rig: As it was bound.
        depsgraph: The evaluated scene.

    Raises:
        HandError: The hand has lost a bone, or its armature.
    """
    # Warp may be missing until this is needed.
    from ...solver.geometry.skin_query import SkinQuery

    scene = depsgraph.scene
    vertices, triangles = evaluated_mesh(item, depsgraph)
    if not len(triangles):
        return None
    matrices = hand_bone_matrices(item, depsgraph)
    missing = [name for name in rig.bone_names if name not in matrices]
    if missing:
        raise HandError(f"{item.name!r} has lost its bone {missing[0]!r}.")
    flesh = posed_skin(rig, np.stack([matrices[name] for name in rig.bone_names]))
    shown = to_meters(scene, transform(world_matrix(item, depsgraph), vertices))
    if not (np.isfinite(flesh).all() and np.isfinite(shown).all()):
        return None
    depth = SkinQuery(shown, triangles).nearest(flesh).depth
    length = float(np.ptp(rig.vertices, axis=0).max())
    return SkinGap(float(np.abs(depth).max()), scene.frame_current, length)
