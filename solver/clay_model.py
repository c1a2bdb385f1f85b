# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface that clay models implement."""

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
        """Put particles to sleep.

        Args:
            resting: Indices of the particles that fall asleep.
            time_step: Length of the last substep [s].
        """

    def unsupported(self, regions: Regions) -> NDArray:
        """Whether each region is asleep but has lost its support, shape [R]."""

    def wake(self, woken: NDArray) -> None:
        """Prepare particles for waking while they still count as asleep."""

    def woken(self) -> None:
        """Finish waking particles, which count as awake by now."""

    def begin_step(self) -> None:
        """Prepare for the substeps of a step."""

    def run_substep(self, substep: ContactPass) -> None:
        """Find contacts, change velocities, move particles, sum the impulses on colliders."""

    def compression(self) -> NDArray:
        """Relative excess of each particle's density over the rest density, at least 0; [N]."""

    @property
    def overflow(self) -> int:
        """Number of list entries dropped for lack of room since the start."""

    def passes(self) -> list[str]:
        """Names of the passes of a substep, in order, for display."""

    def snapshot(self) -> dict[str, NDArray]:
        """All state that determines the next steps."""

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
