# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbour lists: who is near whom, and which of those pairs are bonded.

Each particle keeps a row of slots. A slot holds the neighbour's index and the pair's rest
length: 0 for a free pair, negative while a new bond is being counted in, positive for a bond
(rest length [m]). Both ends keep their own copy of the rest length; the bond law reads only
values that are the same at both ends, so the copies stay equal but for rounding and no pass needs
atomics. Bonds come first in a row, so they survive when a row runs over.
"""

import numpy as np
import warp as wp

SLOTS = 96
"""Neighbours a particle can list: clay at three times its density within two spacings."""

_GRID_CELLS = 64


@wp.kernel(enable_backward=False)
def fill_rows(
    grid: wp.uint64,
    position: wp.array[wp.vec3],
    reach: float,
    old_count: wp.array[int],
    old_index: wp.array2d[int],
    old_rest_length: wp.array2d[float],
    count: wp.array[int],
    index: wp.array2d[int],
    rest_length: wp.array2d[float],
    overflow: wp.array[int],
) -> None:
    """List each particle's neighbours within reach, bonded ones first."""
    i = wp.tid()
    x = position[i]
    used = int(0)
    for slot in range(old_count[i]):
        if old_rest_length[i, slot] > 0.0:
            index[i, used] = old_index[i, slot]
            rest_length[i, used] = old_rest_length[i, slot]
            used += 1
    bonded = used
    for j in wp.hash_grid_query(grid, x, reach):
        if j != i and wp.length_sq(position[j] - x) < reach * reach:
            known = bool(False)
            for slot in range(bonded):
                if index[i, slot] == j:
                    known = True
            if not known:
                if used < SLOTS:
                    index[i, used] = j
                    rest_length[i, used] = 0.0
                    used += 1
                else:
                    wp.atomic_add(overflow, 0, 1)
    count[i] = used


@wp.kernel(enable_backward=False)
def bond_close_pairs(
    position: wp.array[wp.vec3],
    bond_reach: float,
    count: wp.array[int],
    index: wp.array2d[int],
    rest_length: wp.array2d[float],
) -> None:
    """Bond every listed pair closer than the reach at its present length: no stress."""
    i = wp.tid()
    for slot in range(count[i]):
        distance = wp.length(position[index[i, slot]] - position[i])
        if distance < bond_reach and distance > 0.0:
            rest_length[i, slot] = distance


@wp.kernel(enable_backward=False)
def measure_displacement(
    position: wp.array[wp.vec3],
    listed_position: wp.array[wp.vec3],
    largest: wp.array[float],
) -> None:
    """Find how far any particle has moved since the rows were filled."""
    i = wp.tid()
    wp.atomic_max(largest, 0, wp.length(position[i] - listed_position[i]))


class Neighbors:
    """The rows of all particles, refilled when something has moved too far.

    Args:
        particle_count: Number of particles.
        reach: Distance within which pairs interact [m].
        skin: Extra distance listed [m]; rows stay valid until a particle moved half of it.
        device: Warp device.
    """

    def __init__(self, particle_count: int, reach: float, skin: float, device: wp.Device) -> None:
        self.reach = reach + skin
        self.skin = skin
        self.device = device
        self.particle_count = particle_count
        rows = (particle_count, SLOTS)
        self.count = wp.zeros(particle_count, dtype=int, device=device)
        self.index = wp.zeros(rows, dtype=int, device=device)
        self.rest_length = wp.zeros(rows, dtype=float, device=device)
        self._old_count = wp.zeros_like(self.count)
        self._old_index = wp.zeros_like(self.index)
        self._old_rest_length = wp.zeros_like(self.rest_length)
        self.listed_position = wp.zeros(particle_count, dtype=wp.vec3, device=device)
        self._largest = wp.zeros(1, dtype=float, device=device)
        self._overflow = wp.zeros(1, dtype=int, device=device)
        self._grid = wp.HashGrid(_GRID_CELLS, _GRID_CELLS, _GRID_CELLS, device=device)
        self.rebuild_count = 0

    def rebuild(self, position: wp.array) -> None:
        """Refill all rows around the given positions, keeping every bond."""
        wp.copy(self._old_count, self.count)
        wp.copy(self._old_index, self.index)
        wp.copy(self._old_rest_length, self.rest_length)
        self._grid.build(position, self.reach)
        wp.launch(
            fill_rows,
            dim=self.particle_count,
            inputs=[
                self._grid.id,
                position,
                self.reach,
                self._old_count,
                self._old_index,
                self._old_rest_length,
                self.count,
                self.index,
                self.rest_length,
                self._overflow,
            ],
            device=self.device,
        )
        wp.copy(self.listed_position, position)
        self.rebuild_count += 1

    def bond_all(self, position: wp.array, bond_reach: float) -> None:
        """Bond all pairs closer than ``bond_reach`` [m] as they lie."""
        wp.launch(
            bond_close_pairs,
            dim=self.particle_count,
            inputs=[position, bond_reach, self.count, self.index, self.rest_length],
            device=self.device,
        )

    def rebuild_if_moved(self, position: wp.array) -> None:
        """Refill the rows where a particle has used up its half of the skin."""
        self._largest.zero_()
        wp.launch(
            measure_displacement,
            dim=self.particle_count,
            inputs=[position, self.listed_position, self._largest],
            device=self.device,
        )
        if self._largest.numpy()[0] > 0.5 * self.skin:
            self.rebuild(position)

    @property
    def overflow(self) -> int:
        """Neighbours that found no free slot, since the beginning."""
        return int(self._overflow.numpy()[0])

    def snapshot(self) -> dict[str, np.ndarray]:
        """State that decides what the next passes do; rows cut to the widest one."""
        count = self.count.numpy()
        width = int(count.max(initial=0))
        return {
            "neighbor_count": count.copy(),
            "neighbor_index": self.index.numpy()[:, :width].copy(),
            "neighbor_rest_length": self.rest_length.numpy()[:, :width].copy(),
            "neighbor_listed_position": self.listed_position.numpy().copy(),
            "neighbor_overflow": self._overflow.numpy().copy(),
        }

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Take up the state that `snapshot` gave."""
        width = snapshot["neighbor_index"].shape[1]
        rows = np.zeros((self.particle_count, SLOTS), np.int32)
        rows[:, :width] = snapshot["neighbor_index"]
        self.index.assign(rows)
        lengths = np.zeros((self.particle_count, SLOTS), np.float32)
        lengths[:, :width] = snapshot["neighbor_rest_length"]
        self.rest_length.assign(lengths)
        self.count.assign(snapshot["neighbor_count"])
        self.listed_position.assign(snapshot["neighbor_listed_position"])
        self._overflow.assign(snapshot["neighbor_overflow"])
