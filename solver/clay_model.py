# SPDX-License-Identifier: GPL-3.0-or-later
"""What the solver asks of a clay model."""

from typing import Protocol

from numpy.typing import NDArray

from .contact.law import ContactPass
from .core.regions import Regions


class ClayModel(Protocol):
    """Computes the forces of clay on itself and on the colliders in a substep.

    A model is built with the particles, the contacts and the settings, and updates them in place.
    """

    @property
    def can_sleep(self) -> bool:
        """Whether parts of the clay may sleep while others move."""

    def rest(self, resting: NDArray, time_step: float) -> None:
        """Bring particles that fall asleep to rest.

        Args:
            resting: Their indices.
            time_step: Length of the last substep [s].
        """

    def unheld(self, regions: Regions) -> NDArray:
        """Whether each region sleeps and is no longer held by anything, shape [R]."""

    def wake(self, woken: NDArray) -> None:
        """Prepare to wake particles, which still count as asleep."""

    def woken(self) -> None:
        """Finish waking particles, which now count as awake."""

    def begin_step(self) -> None:
        """Prepare for the substeps of a step."""

    def run_substep(self, substep: ContactPass) -> None:
        """Find contacts, change velocities, move particles, sum the impulses on colliders."""

    def compression(self) -> NDArray:
        """Each particle's relative excess of density over that at rest, at least 0; shape [N]."""

    @property
    def overflow(self) -> int:
        """Number of entries that found no room in a list, since the start."""

    def passes(self) -> list[str]:
        """Names of the passes of a substep, in order, for people to read."""

    def snapshot(self) -> dict[str, NDArray]:
        """All state that determines the next steps."""

    def restore(self, state: dict[str, NDArray]) -> None:
        """Return to the state that `snapshot` gave."""
