# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand in a scene: where its bones are to be, and what it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..hand.rig import HandRig

YOUNG_MODULUS = 5.0e4
"""Of flesh under slow pressure [Pa]; soft tissue of fingertips and palms has 30 to 100 kPa."""
POISSON_RATIO = 0.45
"""Of flesh. Real flesh is nearly incompressible, which linear tetrahedra cannot be."""
FARTHEST = 1.0e4
"""Hands are nearer than this to the origin, in each coordinate [m]."""
MOST_STRETCH = 4.0
"""A bone may become this much longer or shorter than at rest."""


@dataclass(frozen=True)
class HandContacts:
    """What the ghosts on a hand's skin feel, mean over the last step."""

    positions: NDArray[np.float64]
    """Where the ghosts are [m], shape [G, 3]."""
    normals: NDArray[np.float64]
    """Outward unit normals of the skin there, shape [G, 3]."""
    areas: NDArray[np.float64]
    """Skin that each stands for at rest [m²], shape [G]; they add up to that of the hand."""
    forces: NDArray[np.float64]
    """Force of the clay on each [N], shape [G, 3]; they add up to that on the hand."""


class Hand:
    """A hand with soft flesh on bones that are moved from outside.

    Made by `Scene.add_hand`. Bones set between two steps are reached at the end of the next step,
    evenly in between.
    """

    def __init__(
        self,
        rig: HandRig,
        *,
        friction: float,
        young_modulus: float,
        poisson_ratio: float,
        hold_stiffness: float | None,
    ) -> None:
        self.rig = rig
        self.friction = friction
        self.young_modulus = young_modulus
        self.poisson_ratio = poisson_ratio
        self.hold_stiffness = hold_stiffness
        self._index = {name: index for index, name in enumerate(rig.bone_names)}
        self._bones = rig.bone_rest.copy()
        self._tracked = True
        self._rest_inverse = np.linalg.inv(rig.bone_rest)

    @property
    def bones(self) -> NDArray[np.float64]:
        """World from each bone's own coordinates, as last set, shape [B, 4, 4]."""
        return self._bones

    @property
    def tracked(self) -> bool:
        """Whether it is known where the hand is."""
        return self._tracked

    def set_bones(self, bones: Mapping[str, ArrayLike]) -> None:
        """Move bones to poses by the end of the next step; those not named stay.

        Args:
            bones: World from each bone's own coordinates, by name, shape [4, 4] each.

        Raises:
            ValueError: A bone that the rig does not have, or a matrix that is not 4×4, not finite,
                not affine, mirrored, or stretched beyond reason. The hand keeps its last good pose,
                of all bones.
        """
        changed = self._bones.copy()
        for name, pose in bones.items():
            if name not in self._index:
                known = ", ".join(self._index)
                raise ValueError(f"The hand has no bone {name!r}; it has {known}.")
            matrix = np.asarray(pose, np.float64)
            if matrix.shape != (4, 4):
                raise ValueError(
                    f"The pose of bone {name!r} has shape {matrix.shape}; it must be a 4x4 matrix."
                )
            changed[self._index[name]] = matrix
        rows = [self._index[name] for name in bones]
        if not rows:
            return
        self._check(changed[rows], list(bones), self._rest_inverse[rows])
        self._bones = changed

    @staticmethod
    def _check(poses: NDArray, names: list[str], rest_inverse: NDArray) -> None:
        kept = "The last good pose is kept."
        finite = np.isfinite(poses).all((1, 2))
        if not finite.all():
            name = names[int(np.argmin(finite))]
            raise ValueError(f"The pose of bone {name!r} has values that are not finite. {kept}")
        affine = np.isclose(poses[:, 3], (0.0, 0.0, 0.0, 1.0)).all(1)
        if not affine.all():
            name = names[int(np.argmin(affine))]
            raise ValueError(f"The last row of bone {name!r}'s pose must be 0 0 0 1. {kept}")
        near = (np.abs(poses[:, :3, 3]) < FARTHEST).all(1)
        if not near.all():
            name = names[int(np.argmin(near))]
            raise ValueError(
                f"The pose of bone {name!r} is farther than {FARTHEST:g} m away; are its units "
                f"metres? {kept}"
            )
        turns = poses[:, :3, :3] @ rest_inverse[:, :3, :3]
        upright = np.linalg.det(turns) > 0.0
        if not upright.all():
            name = names[int(np.argmin(upright))]
            raise ValueError(
                f"The pose of bone {name!r} is mirrored against its rest pose or flat; bind a hand "
                f"of the other side, or give every axis a scale above zero. {kept}"
            )
        scales = np.linalg.svd(turns, compute_uv=False)
        within = (scales < MOST_STRETCH).all(1) & (scales > 1.0 / MOST_STRETCH).all(1)
        if not within.all():
            name = names[int(np.argmin(within))]
            raise ValueError(
                f"The pose of bone {name!r} stretches it more than {MOST_STRETCH:g} times against "
                f"its rest pose; bind the hand again at its new size. {kept}"
            )

    def set_tracked(self, tracked: bool) -> None:
        """Say whether it is known where the hand is.

        A hand that is not stays where it was, and touches nothing. When it is known again, the hand
        is at its bones' poses at once, and takes hold of the clay by and by: clay inside it is
        moved out gently, and what moves it out is not reported as force.
        """
        self._tracked = bool(tracked)
