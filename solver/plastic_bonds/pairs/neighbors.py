# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbor search: refilling the `rows` when something has moved too far.

Bonds stay in a row at any length; the search only has to find pairs that may come close next. On
the CPU, particles are sorted into cells (`neighbors_cpu`); on a GPU, Warp's hash grid finds them.
"""

from typing import Any

import numpy as np
import warp as wp

from ...core.awake import Awake, awake_particle
from ...core.particles import ByPart, Particles
from . import neighbors_cpu
from .pairs import Pairs
from .rows import MAX_SLOTS, PairRows, keep_bonds, swap_slots

_GRID_CELLS = 64
RIGID_SAMPLES = 1000
"""The rigid motion of all clay is fitted to at least this many particles, if so many exist."""


@wp.kernel(enable_backward=False)
def fill_rows(
    awake: Awake,
    grid: wp.uint64,
    position: wp.array[wp.vec3],
    reach: float,
    pairs: PairRows,
    needed: wp.array[int],
) -> None:
    """List each particle's neighbors within reach, bonded ones first, as room permits."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    x = position[i]
    bonded = keep_bonds(pairs, i)
    first = pairs.first[i]
    used = bonded
    for j in wp.hash_grid_query(grid, x, reach):
        if j != i and wp.length_sq(position[j] - x) < reach * reach:
            known = bool(False)
            for e in range(bonded):
                if pairs.other[first + e] == j:
                    known = True
            if not known:
                if used < pairs.room[i]:
                    pairs.other[first + used] = j
                    pairs.rest_length[first + used] = 0.0
                used += 1
    needed[i] = used
    pairs.listed[i] = wp.min(used, pairs.room[i])


@wp.kernel(enable_backward=False)
def bond_close_pairs(position: wp.array[wp.vec3], bond_reach: float, pairs: PairRows) -> None:
    """Bond every listed pair closer than the reach at its current length, without stress."""
    i = wp.tid()
    first = pairs.first[i]
    end = first
    for slot in range(first, first + pairs.listed[i]):
        distance = wp.length(position[pairs.other[slot]] - position[i])
        if distance < bond_reach and distance > 0.0:
            pairs.rest_length[slot] = distance
            swap_slots(pairs, slot, end)
            end += 1
    pairs.acting[i] = end - first


@wp.kernel(enable_backward=False)
def measure_displacement(
    awake: Awake,
    position: wp.array[wp.vec3],
    listed_position: wp.array[wp.vec3],
    frame: wp.array[wp.mat44],
    largest: wp.array[float],
) -> None:
    """Find how far any particle has moved since the rows were filled, squared, in their frame."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    moved = wp.length_sq(position[i] - wp.transform_point(frame[0], listed_position[i]))
    if moved > largest[0]:
        wp.atomic_max(largest, 0, moved)


@wp.kernel(enable_backward=False)
def match_rows(woken: wp.array[int], pairs: PairRows) -> None:
    """Give waking particles the current rest lengths of their bonds to awake particles."""
    i = woken[wp.tid()]
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        j = pairs.other[slot]
        if pairs.resting[j] == 0:
            rest = float(0.0)
            for theirs in range(pairs.first[j], pairs.first[j] + pairs.acting[j]):
                if pairs.other[theirs] == i:
                    rest = wp.max(pairs.rest_length[theirs], 0.0)
            pairs.rest_length[slot] = rest


@wp.kernel(enable_backward=False)
def mark_one_sided(awake: Awake, needed: wp.array[int], pairs: PairRows) -> None:
    """Mark pairs for which the other end had no room, by the complement of its index."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    for slot in range(pairs.first[i], pairs.first[i] + pairs.listed[i]):
        j = pairs.other[slot]
        if pairs.resting[j] == 0 and needed[j] > pairs.room[j]:
            mutual = bool(False)
            for theirs in range(pairs.first[j], pairs.first[j] + pairs.listed[j]):
                if pairs.other[theirs] == i:
                    mutual = True
            if not mutual:
                pairs.other[slot] = -1 - j


@wp.kernel(enable_backward=False)
def drop_marked(awake: Awake, pairs: PairRows) -> None:
    """Remove marked pairs: acting at one end only, they would create momentum."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    first = pairs.first[i]
    kept = first
    acting = int(0)
    for slot in range(first, first + pairs.listed[i]):
        if pairs.other[slot] >= 0:
            pairs.other[kept] = pairs.other[slot]
            pairs.rest_length[kept] = pairs.rest_length[slot]
            if slot < first + pairs.acting[i]:
                acting += 1
            kept += 1
    pairs.listed[i] = kept - first
    pairs.acting[i] = acting


class Neighbors:
    """Fills the rows, and refills them when particles have moved too far.

    Args:
        particles: The particles whose neighbors are listed.
        pairs: The pairs whose rows are filled.
        reach: Distance within which pairs interact [m].
        skin: Extra distance listed [m]; rows stay valid until a particle has moved half of it.
    """

    def __init__(self, particles: Particles, pairs: Pairs, reach: float, skin: float) -> None:
        self.particles = particles
        self.pairs = pairs
        self.reach = reach + skin
        self.skin = skin
        count, device = particles.count, particles.device
        self.listed_position = wp.zeros(count, dtype=wp.vec3, device=device)
        self.needed = wp.zeros(count, dtype=int, device=device)
        """Number of slots that each row would fill given enough room."""
        self.largest = wp.zeros((particles.parts, 1), dtype=float, device=device)
        """Largest displacement since the rows were filled, squared, by part [m²]."""
        self.frame = wp.array(np.eye(4)[None], dtype=wp.mat44, device=device)
        """Rigid motion of all the clay since the rows were filled; it changes no distances."""
        self.overflow = 0
        """Number of neighbors dropped for lack of a free slot since the start."""
        self.rebuild_count = 0
        self._hash_grid: wp.HashGrid | None = None
        if device.is_cpu:
            self._cells = neighbors_cpu.make_cell_grid(particles, self.reach)
        else:
            self._hash_grid = wp.HashGrid(_GRID_CELLS, _GRID_CELLS, _GRID_CELLS, device=device)

    def rebuild(self) -> None:
        """Refill the rows of all awake particles, keeping every bond."""
        position = self.particles.position
        if self._hash_grid:
            self._hash_grid.build(position, self.reach)
        else:
            neighbors_cpu.sort_into_cells(self._cells, self.particles, self.reach)
        self._fill()
        needed = self.needed.numpy()
        short = needed > self.pairs.rows.room.numpy()
        if short.any():
            self.overflow += int(np.maximum(needed[short] - MAX_SLOTS, 0).sum())
            if (needed[short] < MAX_SLOTS).any() or self.rebuild_count == 0:
                self.pairs.make_room(np.flatnonzero(short), needed)
                self._fill()
            if (needed[short] > MAX_SLOTS).any():
                self.particles.launch(mark_one_sided, self.needed, self.pairs.rows)
                self.particles.launch(drop_marked, self.pairs.rows)
        wp.copy(self.listed_position, position)
        self.frame.assign(np.eye(4, dtype=np.float32)[None])
        self.largest.zero_()
        self.rebuild_count += 1

    def _fill(self) -> None:
        grid: Any = self._hash_grid.id if self._hash_grid else self._cells
        self.particles.launch_side_by_side(
            fill_rows if self._hash_grid else neighbors_cpu.fill_rows,
            grid,
            self.particles.position,
            self.reach,
            self.pairs.rows,
            self.needed,
        )

    def match(self, woken: wp.array) -> None:
        """Update the rows of particles that are about to wake.

        Args:
            woken: Indices of the particles, which still count as resting.
        """
        inputs = [woken, self.pairs.rows]
        wp.launch(match_rows, dim=len(woken), inputs=inputs, device=self.particles.device)

    def bond_all(self, bond_reach: float) -> None:
        """Bond all pairs closer than ``bond_reach`` [m] at their current length."""
        wp.launch(
            bond_close_pairs,
            dim=self.particles.count,
            inputs=[self.particles.position, bond_reach, self.pairs.rows],
            device=self.particles.device,
        )

    def measure(self) -> None:
        """Find how far particles have moved. The launches can be recorded."""
        self.particles.run(
            measure_displacement,
            neighbors_cpu.measure_displacement,
            self.particles.position,
            self.listed_position,
            self.frame,
            ByPart.rows(self.largest),
        )

    def _follow_rigid_motion(self) -> bool:
        """Move the frame of displacements with the clay; whether the rows are then still valid.

        Clay on a turning wheel moves far, but its distances do not change.
        """
        particles = self.particles
        if len(particles.awake_index()) < particles.count:
            return False
        every = max(1, particles.count // RIGID_SAMPLES)
        before = self.listed_position.numpy()[::every].astype(np.float64)
        now = particles.position.numpy()[::every].astype(np.float64)
        self.frame.assign(rigid_motion(before, now).astype(np.float32)[None])
        self.largest.zero_()
        self.measure()
        return self._within_skin()

    def _within_skin(self) -> bool:
        return bool(self.largest.numpy().max() <= (0.5 * self.skin) ** 2)

    def rebuild_if_moved(self) -> None:
        """Refill the rows if a particle has moved half of the skin."""
        if not (self._within_skin() or self._follow_rigid_motion()):
            self.rebuild()

    def snapshot(self) -> dict[str, np.ndarray]:
        """State that the next passes depend on; the rows are joined end to end."""
        rows = self.pairs.rows
        listed = rows.listed.numpy()
        slots = _slots(rows.first.numpy(), listed)
        return {
            "neighbor_room": rows.room.numpy().copy(),
            "neighbor_listed": listed.copy(),
            "neighbor_acting": rows.acting.numpy().copy(),
            "neighbor_other": rows.other.numpy()[slots],
            "neighbor_rest_length": rows.rest_length.numpy()[slots],
            "neighbor_position": self.listed_position.numpy().copy(),
            "neighbor_largest": self.largest.numpy().copy(),
            "neighbor_frame": self.frame.numpy().copy(),
            "neighbor_counts": np.array([self.overflow, self.rebuild_count]),
        }

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Restore the state that `snapshot` returned."""
        rows = self.pairs.rows
        rows.listed.zero_()
        self.pairs.lay_out(snapshot["neighbor_room"] - 4)
        slots = _slots(rows.first.numpy(), snapshot["neighbor_listed"])
        for name in ("other", "rest_length"):
            array = getattr(rows, name)
            filled = array.numpy().copy()
            filled[slots] = snapshot[f"neighbor_{name}"]
            array.assign(filled)
        rows.listed.assign(snapshot["neighbor_listed"])
        rows.acting.assign(snapshot["neighbor_acting"])
        self.listed_position.assign(snapshot["neighbor_position"])
        self.largest.assign(snapshot["neighbor_largest"])
        self.frame.assign(snapshot["neighbor_frame"])
        self.overflow, self.rebuild_count = (int(n) for n in snapshot["neighbor_counts"])


def rigid_motion(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Rigid motion that best aligns points with others (Kabsch 1976), shape [4, 4].

    Args:
        before: Points before [m], shape [N, 3].
        now: Points now [m], shape [N, 3].
    """
    center_before, center_now = before.mean(0), now.mean(0)
    left, _, right = np.linalg.svd((before - center_before).T @ (now - center_now))
    flip = np.diag((1.0, 1.0, np.sign(np.linalg.det(left @ right))))
    motion = np.eye(4)
    motion[:3, :3] = (left @ flip @ right).T
    motion[:3, 3] = center_now - motion[:3, :3] @ center_before
    return motion


def _slots(first: np.ndarray, listed: np.ndarray) -> np.ndarray:
    """Slots of the listed neighbors of all rows, row by row."""
    begin = np.cumsum(listed) - listed
    return np.repeat(first - begin, listed) + np.arange(int(listed.sum()))
