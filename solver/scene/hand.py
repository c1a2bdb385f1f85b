# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand in a scene: its bones' poses and the material of its flesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..hand.rig import HandRig

YOUNG_MODULUS = 5.0e4
"""Young's modulus of flesh under slow pressure [Pa]; fingertips and palms have 30 to 100 kPa."""
POISSON_RATIO = 0.45
"""Poisson's ratio of flesh. Real flesh is nearly incompressible, which linear tetrahedra cannot
be."""
MAX_DISTANCE = 1.0e4
"""Largest coordinate of a bone [m]; more is treated as a mistake in units."""
MAX_STRETCH = 4.0
"""Largest factor by which a bone may be longer or shorter than at rest."""


@dataclass(frozen=True)
class HandContacts:
    """Contact forces on the ghosts of a hand's skin, averaged over the last step."""

    positions: NDArray[np.float64]
    """Positions of the ghosts [m], shape [G, 3]."""
    normals: NDArray[np.float64]
    """Outward unit normals of the skin there, shape [G, 3]."""
    areas: NDArray[np.float64]
    """Area of skin at rest that each represents [m²], shape [G]; they add up to the hand's."""
    forces: NDArray[np.float64]
    """Force of the clay on each [N], shape [G, 3]; they add up to the force on the hand."""


class Hand:
    """A hand with soft flesh on bones that the caller moves.

    Made by `Scene.add_hand`. Bones set between two steps move evenly, and arrive at the end of the
    next step.
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
        """Last set transforms from each bone's coordinates to the world, shape [B, 4, 4]."""
        return self._bones

    @property
    def tracked(self) -> bool:
        """Whether the hand is tracked; see `set_tracked`."""
        return self._tracked

    @property
    def bone_names(self) -> tuple[str, ...]:
        """Names of the B bones, in the order of the rig: parents before children."""
        return self.rig.bone_names

    def set_bones(self, bones: Mapping[str, ArrayLike] | ArrayLike) -> None:
        """Move bones to poses by the end of the next step.

        Args:
            bones: Transforms from bone coordinates to the world [m]: of all bones in the order of
                `bone_names`, shape [B, 4, 4], or of those that move, by name, shape [4, 4] each.

        Raises:
            ValueError: The rig has no bone of that name, the number of bones is wrong, or a matrix
                is not 4x4, not finite, not affine, mirrored, or stretched beyond reason. All bones
                keep their last good pose.
        """
        if isinstance(bones, Mapping):
            rows, poses = self._named(bones)
        else:
            rows, poses = list(range(len(self._bones))), np.array(bones, np.float64)
            if poses.shape != self._bones.shape:
                raise ValueError(
                    f"The poses of the bones have shape {poses.shape}; the hand has "
                    f"{len(self._bones)} bones, so the shape must be {self._bones.shape}."
                )
        if not len(poses):
            return
        names = [self.bone_names[row] for row in rows]
        self._check(poses, names, self._rest_inverse[rows])
        changed = self._bones.copy()
        changed[rows] = poses
        self._bones = changed

    def _named(self, bones: Mapping[str, ArrayLike]) -> tuple[list[int], NDArray[np.float64]]:
        """Indices and poses of bones given by name, shape [n] and [n, 4, 4]."""
        rows, poses = [], np.empty((len(bones), 4, 4))
        for number, (name, pose) in enumerate(bones.items()):
            if name not in self._index:
                known = ", ".join(self._index)
                raise ValueError(f"The hand has no bone {name!r}; it has {known}.")
            matrix = np.asarray(pose, np.float64)
            if matrix.shape != (4, 4):
                raise ValueError(
                    f"The pose of bone {name!r} has shape {matrix.shape}; it must be a 4x4 matrix."
                )
            rows.append(self._index[name])
            poses[number] = matrix
        return rows, poses

    @staticmethod
    def _check(poses: NDArray, names: Sequence[str], rest_inverse: NDArray) -> None:
        kept = "The last good pose is kept."
        finite = np.isfinite(poses).all((1, 2))
        if not finite.all():
            name = names[int(np.argmin(finite))]
            raise ValueError(f"The pose of bone {name!r} has values that are not finite. {kept}")
        affine = np.isclose(poses[:, 3], (0.0, 0.0, 0.0, 1.0)).all(1)
        if not affine.all():
            name = names[int(np.argmin(affine))]
            raise ValueError(f"The last row of bone {name!r}'s pose must be 0 0 0 1. {kept}")
        near = (np.abs(poses[:, :3, 3]) < MAX_DISTANCE).all(1)
        if not near.all():
            name = names[int(np.argmin(near))]
            raise ValueError(
                f"The pose of bone {name!r} is farther than {MAX_DISTANCE:g} m away; are its units "
                f"meters? {kept}"
            )
        turns = poses[:, :3, :3] @ rest_inverse[:, :3, :3]
        upright = np.linalg.det(turns) > 0.0
        if not upright.all():
            name = names[int(np.argmin(upright))]
            raise ValueError(
                f"The pose of bone {name!r} is mirrored relative to its rest pose, or flat; bind a "
                f"hand of the other side, or give every axis a scale above zero. {kept}"
            )
        scales = np.linalg.svd(turns, compute_uv=False)
        within = (scales < MAX_STRETCH).all(1) & (scales > 1.0 / MAX_STRETCH).all(1)
        if not within.all():
            name = names[int(np.argmin(within))]
            raise ValueError(
                f"The pose of bone {name!r} stretches or shrinks it over {MAX_STRETCH:g} times "
                f"relative to its rest pose; bind the hand again at its new size. {kept}"
            )

    def set_tracked(self, tracked: bool) -> None:
        """Set whether the hand's position is known.

        A hand that is not tracked stays where it was and touches nothing. When tracking returns,
        the hand jumps to its bones' poses and grips the clay gradually: clay inside it is moved out
        gently, which is not reported as force.
        """
        self._tracked = bool(tracked)
