# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbor rows of the paper's clay: pairs within the kernel's reach, and which are bonded.

Both ends of a pair keep their own copy of its state and make the same decisions from the same
numbers, so that no pass needs atomics and results do not depend on the order of threads.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .kernel import cubic_gradient

SLOTS = 96
"""Largest number of neighbors of a particle: clay at three times its density."""
SUPPORT_SLOTS = 64
"""Largest number of neighbors within the kernel's support: clay at twice its density."""
_GRID_CELLS = 64


@wp.struct
class Rows:
    """A row of neighbors for each particle, bonded ones first."""

    count: wp.array[int]
    index: wp.array2d[int]
    rest_length: wp.array2d[float]
    """Rest length of a bond [m]; 0 for a pair without one."""
    waited: wp.array2d[float]
    """How long the pair's rate has been past the threshold for the other state [s]."""


@wp.kernel(enable_backward=False)
def fill_rows(
    grid: wp.uint64,
    position: wp.array[wp.vec3],
    reach: float,
    before: Rows,
    listed: Rows,
    overflow: wp.array[int],
) -> None:
    """List each particle's neighbors within reach, and keep the state of known pairs."""
    i = wp.tid()
    x = position[i]
    used = int(0)
    for slot in range(before.count[i]):
        if before.rest_length[i, slot] > 0.0:
            listed.index[i, used] = before.index[i, slot]
            listed.rest_length[i, used] = before.rest_length[i, slot]
            listed.waited[i, used] = before.waited[i, slot]
            used += 1
    bonded = used
    for j in wp.hash_grid_query(grid, x, reach):
        if j != i and wp.length_sq(position[j] - x) < reach * reach:
            known = bool(False)
            for slot in range(bonded):
                if listed.index[i, slot] == j:
                    known = True
            if not known:
                if used < SLOTS:
                    waited = float(0.0)
                    for slot in range(before.count[i]):
                        if before.index[i, slot] == j:
                            waited = before.waited[i, slot]
                    listed.index[i, used] = j
                    listed.rest_length[i, used] = 0.0
                    listed.waited[i, used] = waited
                    used += 1
                else:
                    wp.atomic_add(overflow, 0, 1)
    listed.count[i] = used


@wp.struct
class Support:
    """The neighbors of each particle within the kernel's support at the start of a substep."""

    count: wp.array[int]
    index: wp.array2d[int]
    gradient: wp.array2d[wp.vec3]
    """V ∇W at the particle [1/m]."""


@wp.kernel(enable_backward=False)
def gather_support(
    volume: float,
    kernel_radius: float,
    rows: Rows,
    position: wp.array[wp.vec3],
    support: Support,
    overflow: wp.array[int],
) -> None:
    """Pick the neighbors within the kernel's support, and compute their kernel gradients."""
    i = wp.tid()
    used = int(0)
    for slot in range(rows.count[i]):
        j = rows.index[i, slot]
        offset = position[j] - position[i]
        if wp.length_sq(offset) < kernel_radius * kernel_radius:
            if used < SUPPORT_SLOTS:
                support.index[i, used] = j
                support.gradient[i, used] = cubic_gradient(offset, kernel_radius) * volume
                used += 1
            else:
                wp.atomic_add(overflow, 0, 1)
    support.count[i] = used


@wp.kernel(enable_backward=False)
def measure_displacement(
    position: wp.array[wp.vec3],
    listed_position: wp.array[wp.vec3],
    max_displacement: wp.array[float],
) -> None:
    """Find how far any particle has moved since the rows were filled."""
    i = wp.tid()
    wp.atomic_max(max_displacement, 0, wp.length(position[i] - listed_position[i]))


class NeighborRows:
    """The rows of all particles, refilled when something has moved too far.

    Args:
        particle_count: Number of particles.
        spacing: Particle spacing at rest [m].
        kernel_radius: Support of the kernel [m], the distance within which pairs interact.
        skin: Extra distance listed [m]; rows stay valid until a particle has moved half of it.
        device: Warp device.
    """

    def __init__(
        self,
        particle_count: int,
        spacing: float,
        kernel_radius: float,
        skin: float,
        device: wp.Device,
    ) -> None:
        self.volume = spacing**3
        self.kernel_radius = kernel_radius
        self.reach = kernel_radius + skin
        self.skin = skin
        self.device = device
        self.particle_count = particle_count
        self.rows = self._make_rows()
        self._spare = self._make_rows()
        self.support = Support()
        shape = (particle_count, SUPPORT_SLOTS)
        self.support.count = wp.zeros(particle_count, dtype=int, device=device)
        self.support.index = wp.zeros(shape, dtype=int, device=device)
        self.support.gradient = wp.zeros(shape, dtype=wp.vec3, device=device)
        self.listed_position = wp.zeros(particle_count, dtype=wp.vec3, device=device)
        self._largest = wp.zeros(1, dtype=float, device=device)
        self._overflow = wp.zeros(1, dtype=int, device=device)
        self._grid = wp.HashGrid(_GRID_CELLS, _GRID_CELLS, _GRID_CELLS, device=device)

    def _make_rows(self) -> Rows:
        shape = (self.particle_count, SLOTS)
        rows = Rows()
        rows.count = wp.zeros(self.particle_count, dtype=int, device=self.device)
        rows.index = wp.zeros(shape, dtype=int, device=self.device)
        rows.rest_length = wp.zeros(shape, dtype=float, device=self.device)
        rows.waited = wp.zeros(shape, dtype=float, device=self.device)
        return rows

    def rebuild(self, position: wp.array) -> None:
        """Refill all rows around the given positions, keeping every bond."""
        self._grid.build(position, self.reach)
        wp.launch(
            fill_rows,
            dim=self.particle_count,
            inputs=[
                self._grid.id,
                position,
                self.reach,
                self.rows,
                self._spare,
                self._overflow,
            ],
            device=self.device,
        )
        self.rows, self._spare = self._spare, self.rows
        wp.copy(self.listed_position, position)

    def _rebuild_if_moved(self, position: wp.array) -> None:
        """Refill the rows if a particle has moved half of the skin."""
        self._largest.zero_()
        wp.launch(
            measure_displacement,
            dim=self.particle_count,
            inputs=[position, self.listed_position, self._largest],
            device=self.device,
        )
        if self._largest.numpy()[0] > 0.5 * self.skin:
            self.rebuild(position)

    def begin_substep(self, position: wp.array) -> None:
        """Bring the rows and the kernel's support up to date."""
        self._rebuild_if_moved(position)
        wp.launch(
            gather_support,
            dim=self.particle_count,
            inputs=[
                self.volume,
                self.kernel_radius,
                self.rows,
                position,
                self.support,
                self._overflow,
            ],
            device=self.device,
        )

    @property
    def overflow(self) -> int:
        """Number of neighbors dropped for lack of a free slot since the start."""
        return int(self._overflow.numpy()[0])

    def snapshot(self) -> dict[str, NDArray]:
        """State that determines the next passes; the rows are joined end to end."""
        count = self.rows.count.numpy().copy()
        used = np.arange(SLOTS) < count[:, None]
        return {
            "neighbor_count": count,
            "neighbor_index": self.rows.index.numpy()[used],
            "neighbor_rest_length": self.rows.rest_length.numpy()[used],
            "neighbor_waited": self.rows.waited.numpy()[used],
            "neighbor_position": self.listed_position.numpy().copy(),
            "neighbor_overflow": self._overflow.numpy().copy(),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
        count = state["neighbor_count"]
        used = np.arange(SLOTS) < count[:, None]
        self.rows.count.assign(count)
        for name in ("index", "rest_length", "waited"):
            rows = np.zeros((self.particle_count, SLOTS), state[f"neighbor_{name}"].dtype)
            rows[used] = state[f"neighbor_{name}"]
            getattr(self.rows, name).assign(rows)
        self.listed_position.assign(state["neighbor_position"])
        self._overflow.assign(state["neighbor_overflow"])
