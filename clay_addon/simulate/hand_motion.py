# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands during a simulation: the rig and the motion of its bones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.mesh_geometry import SWITCHED_OFF, is_absent, is_switched_off
from ..hands.gap import SkinGap, skin_gap
from ..hands.hand import hand_bone_matrices, hand_message, read_hand_rig
from ..hands.reading import HandError, hand_armature
from ..tracking.armature import CONTACT_PROPERTY

if TYPE_CHECKING:
    from ...solver import Hand, Scene

MIN_CONTACT = 0.5
"""A hand with a lower value of the contact property does not touch the clay. When the value rises
again, the solver restores the contact gradually."""


class HandState(NamedTuple):
    """State of a hand at a frame."""

    bones: NDArray[np.float64]
    """Transform of each bone from local to world space [m], in rig order, shape [B, 4, 4]."""
    tracked: bool
    """Whether the tracker sees the hand."""


class MovingHand:
    """A clay hand in a simulation.

    The constructor temporarily links a copy of the hand into the scene, so it must not be called
    from a handler or panel.

    Args:
        context: The context of the hand.
        item: Mesh object of the hand.
        hold_stiffness: Stiffness with which the hand holds its pose against the clay [N/m]; None if
            the clay cannot move it.

    Raises:
        HandError: The hand is not bound, or has changed since; the message says what to do.
    """

    def __init__(
        self,
        context: bpy.types.Context,
        item: bpy.types.Object,
        *,
        hold_stiffness: float | None = None,
    ) -> None:
        self.item = item
        self.hold_stiffness = hold_stiffness
        self.rig = read_hand_rig(context, item)
        # Without an update, a new custom property does not reach the evaluated armature.
        hand_armature(item).update_tag()
        self.friction = float(item.tactile_clay.collider_friction)
        self.handle: Hand | None = None
        self._notice = hand_message(context.scene, item)
        self._dropped: dict[int, str] = {}
        self._gap: SkinGap | None = None

    def digest_parts(self) -> tuple[object, ...]:
        """Values that determine the hand's effect on the clay, apart from its motion."""
        hold_stiffness = () if self.hold_stiffness is None else (self.hold_stiffness,)
        rig = (np.asarray(part) for part in self.rig.to_arrays().values())
        return (self.friction, *hold_stiffness, *rig)

    def check(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Refuse a hand that Blender does not evaluate.

        Raises:
            HandError: The hand or its armature is switched off or missing.
        """
        for part in (self.item, hand_armature(self.item)):
            if is_switched_off(part, depsgraph):
                raise HandError(f"{part.name!r} {SWITCHED_OFF}")

    def start(self, scene: Scene, depsgraph: bpy.types.Depsgraph) -> None:
        """Add the hand to a solver's scene in its pose at the current frame.

        Raises:
            HandError: The pose is impossible.
            ValueError: The solver refuses the hand.
        """
        handle = scene.add_hand(
            self.rig, friction=self.friction, hold_stiffness=self.hold_stiffness
        )
        bones = self._bones(hand_bone_matrices(self.item, depsgraph))
        try:
            handle.set_bones(bones)
        except ValueError as error:
            raise HandError(
                f"{self.item.name!r} cannot start from its pose at frame "
                f"{depsgraph.scene.frame_current}: {_reason(error)}"
            ) from error
        handle.set_tracked(self._tracked(depsgraph))
        self.handle = handle

    def feed(self, depsgraph: bpy.types.Depsgraph) -> HandState:
        """Read the hand's pose at the current frame, and pass it to the solver if it is running.

        An impossible pose, such as one with a mirrored bone, is dropped and the last good one held;
        `warnings` reports it.

        Raises:
            HandError: The hand is switched off or missing.
        """
        self.check(depsgraph)
        number = depsgraph.scene.frame_current
        tracked = self._tracked(depsgraph)
        try:
            bones = self._bones(hand_bone_matrices(self.item, depsgraph))
            if self.handle is not None:
                self.handle.set_bones(bones)
        except (HandError, ValueError) as error:
            if isinstance(error, HandError):
                bones = np.full((len(self.rig.bone_names), 4, 4), np.nan)
            if self.handle is not None:
                self._dropped[number] = _reason(error)
        if self.handle is not None:
            self.handle.set_tracked(tracked)
        return HandState(bones, tracked)

    def measure(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Compare the flesh with the mesh that is shown at the current frame.

        Raises:
            HandError: The hand has lost a bone, or its armature.
        """
        if self._tracked(depsgraph):
            gap = skin_gap(self.item, self.rig, depsgraph)
            if gap is not None and (self._gap is None or gap.meters > self._gap.meters):
                self._gap = gap

    def held_pose(self) -> NDArray[np.float64]:
        """The last good pose that was given to the solver [m], shape [B, 4, 4]."""
        assert self.handle is not None
        return self.handle.bones

    def restore_pose(self, bones: NDArray[np.float64]) -> None:
        """Restore a pose returned by `held_pose`.

        Raises:
            ValueError: The pose belongs to another hand.
        """
        assert self.handle is not None
        if bones.shape != self.handle.bones.shape:
            raise ValueError(f"The pose of {self.item.name!r} has shape {bones.shape}.")
        self.handle.set_bones(bones)

    def warnings(self) -> list[str]:
        """Warnings about the hand's motion for the user."""
        found = [self._notice] if self._notice else []
        if self._gap is not None and self._gap.too_large:
            found.append(self._gap.warning(self.item.name))
        if self._dropped:
            first = min(self._dropped)
            count = len(self._dropped)
            found.append(
                f"The pose of {self.item.name!r} was dropped at {count} "
                f"{'frame' if count == 1 else 'frames'}, first at frame {first}, and the last good "
                f"one held: {self._dropped[first]}"
            )
        return found

    def _bones(self, matrices: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        missing = [name for name in self.rig.bone_names if name not in matrices]
        if missing:
            raise HandError(
                f"{self.item.name!r} has lost its bone {missing[0]!r}. Undo, or press Make Clay "
                "Hand again."
            )
        return np.stack([matrices[name] for name in self.rig.bone_names])

    def _tracked(self, depsgraph: bpy.types.Depsgraph) -> bool:
        rig = hand_armature(self.item)
        if is_absent(self.item, depsgraph) or is_absent(rig, depsgraph):
            # By its keys: Blender does not move it, and a ghost must not stay in the clay's way.
            return False
        armature = rig.evaluated_get(depsgraph)
        contact = armature.get(CONTACT_PROPERTY, 1.0)
        if not isinstance(contact, int | float) or not math.isfinite(contact):
            return False
        return contact >= MIN_CONTACT


def _reason(error: Exception) -> str:
    return str(error).removesuffix(" The last good pose is kept.")
