# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solver does for its scene, in words."""

from __future__ import annotations

from collections.abc import Sequence

from .scene.scene import Scene


def passes_of(scene: Scene, model_passes: Sequence[str]) -> list[str]:
    """The passes that a scene needs, in order.

    Args:
        scene: The solver's scene.
        model_passes: Those of the clay model.
    """
    hands = [
        f"soft hand of {len(hand.rig.nodes)} nodes, {len(hand.rig.tetrahedra)} tetrahedra"
        for hand in reversed(scene.hands)
    ]
    passes = [*hands, *model_passes]
    if scene.meshes:
        passes.append(f"contact with {len(scene.meshes)} meshes")
    if scene.hands:
        passes.append(f"contact with {len(scene.hands)} hands, forces on their ghosts")
    if scene.planes:
        passes.append(f"contact with {len(scene.planes)} planes")
    return [*passes, "motion"]
