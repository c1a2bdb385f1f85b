# SPDX-License-Identifier: GPL-3.0-or-later
"""What the solver asks of a clay model."""

from typing import Protocol

from numpy.typing import NDArray

from .contact.law import ContactPass
from .core.regions import Regions


class ClayModel(Protocol):
    """Computes what clay does to itself and to the colliders in a substep.

    A model is built with the particles, the contacts and the settings, and changes them in place.
    """

    @property
    def can_sleep(self) -> bool:
        """Whether parts of the clay may sleep while others move."""

    def rest(self, resting: NDArray, time_step: float) -> None:
        """Bring particles to rest that fall asleep.

        Args:
            resting: Their indices.
            time_step: Length of the last substep [s].
        """

    def unheld(self, regions: Regions) -> NDArray:
        """Which regions sleep and are held by nothing any more, shape [R]."""

    def wake(self, woken: NDArray) -> None:
        """Take up particles that are about to wake; they still count as resting."""

    def woken(self) -> None:
        """Go on with them, now that they are awake."""

    def begin_step(self) -> None:
        """Prepare for the substeps of a step."""

    def run_substep(self, substep: ContactPass) -> None:
        """Find contacts, change velocities, move particles, sum the impulses on colliders."""

    def compression(self) -> NDArray:
        """Each particle's density over that at rest, less one, where positive; shape [N]."""

    @property
    def overflow(self) -> int:
        """How often something found no room in a list, since the beginning."""

    def passes(self) -> list[str]:
        """What a substep consists of, in order, for people to read."""

    def snapshot(self) -> dict[str, NDArray]:
        """All of its state that decides what the next steps do."""

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
