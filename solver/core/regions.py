# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of clay that fall asleep when they come to rest, and wake when they are disturbed.

Sleeping clay keeps its position, its bonds and its force on colliders, and holds its awake
neighbors like a wall: poking a large piece of clay costs only as much as the part that is poked.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from . import regions_cpu
from .awake import Awake, awake_particle
from .grid_boxes import box_of
from .particles import ByPart, Particles

EDGE = 4.0
"""Edge of a region, in spacings: managing regions of half the size costs more than it saves."""
SLEEP_SPEED = 0.002
"""Clay slower than this counts as at rest, in spacings per second."""
SLEEP_DELAY = 0.25
"""Time that a region must be at rest before it falls asleep [s]."""
LAYOUT_TRAVEL = 2.0
"""Regions are laid out again when clay may have moved this far, in spacings."""
WAKE_TRAVEL = 0.1
"""A region wakes its neighbors when its clay may have moved this far, in spacings."""
_REGION_LIMIT = 1 << 15


@wp.kernel(enable_backward=False)
def assign_regions(
    position: wp.array[wp.vec3],
    low: wp.vec3,
    inverse_edge: wp.vec3,
    counts: wp.vec3i,
    region: wp.array[int],
) -> None:
    """Find the region each particle lies in."""
    i = wp.tid()
    place = box_of(position[i], low, inverse_edge, counts)
    region[i] = (place[0] * counts[1] + place[1]) * counts[2] + place[2]


@wp.kernel(enable_backward=False)
def measure_regions(
    awake: Awake,
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    region: wp.array[int],
    measures: wp.array2d[float],
) -> None:
    """Find the bounding box and the highest speed of awake particles in each region.

    A row of ``measures`` holds highest corner, negated lowest corner, and squared speed.
    """
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    own = region[i]
    x = position[i]
    for axis in range(3):
        wp.atomic_max(measures, own, axis, x[axis])
        wp.atomic_max(measures, own, 3 + axis, -x[axis])
    wp.atomic_max(measures, own, 6, wp.length_sq(velocity[i]))


@wp.kernel(enable_backward=False)
def measure_boxes(
    position: wp.array[wp.vec3], region: wp.array[int], measures: wp.array3d[float]
) -> None:
    """Find the bounding box of all particles in each region."""
    i = wp.tid()
    x = position[i]
    for axis in range(3):
        wp.atomic_max(measures, 0, region[i], axis, x[axis])
        wp.atomic_max(measures, 0, region[i], 3 + axis, -x[axis])


class Regions:
    """The regions of the clay, and which of them are awake.

    Args:
        particles: The clay.
        sleeping: Whether clay may fall asleep at all.
    """

    def __init__(self, particles: Particles, *, sleeping: bool) -> None:
        self.particles = particles
        self.sleeping = sleeping
        device = particles.device
        self.region = wp.zeros(particles.count, dtype=int, device=device)
        self._awake = np.ones(particles.count, bool)
        self.generation = 0
        """Changes whenever regions are laid out again, fall asleep or wake."""
        self.lay_out()

    @property
    def outgrown(self) -> bool:
        """Whether clay may have moved so far that regions should be laid out again."""
        return self._layout_travel > LAYOUT_TRAVEL * self.particles.spacing

    def lay_out(self) -> NDArray[np.int64]:
        """Lay a grid of regions over the clay.

        Returns:
            Indices of sleeping particles that now share a region with awake ones: they must wake
            before `set_asleep`.
        """
        particles = self.particles
        self.generation += 1
        low, high = particles.box()
        extent = np.maximum(high.astype(float) - low, 1e-9)
        edge = EDGE * particles.spacing
        while np.prod(np.floor(extent / edge) + 1.0) > _REGION_LIMIT:
            edge *= 1.25
        # The highest particle must fall into the last region.
        low = low - 1e-3 * edge
        self.shape = tuple((np.floor((extent + 2e-3 * edge) / edge) + 1).astype(int).tolist())
        grid = [wp.vec3(*low), wp.vec3(1.0 / edge), wp.vec3i(*self.shape)]
        inputs = [particles.position, *grid, self.region]
        wp.launch(assign_regions, dim=particles.count, inputs=inputs, device=particles.device)
        count = int(np.prod(self.shape))
        region = self.region.numpy()
        self.asleep = np.ones(count, bool)
        self.asleep[region[self._awake]] = False
        self.quiet = np.zeros(count)
        self.travel = np.zeros(count)
        self.measures = self._make_measures(count)
        self.boxes = np.zeros((count, 2, 3))
        self.speed = np.zeros(count)
        self._layout_travel = 0.0
        self._measure_sleeping()
        self.measure(0.0)
        return np.flatnonzero(~self._awake & ~self.asleep[region])

    def _make_measures(self, regions: int) -> wp.array:
        shape = (self.particles.parts, regions, 7)
        return wp.zeros(shape, dtype=float, device=self.particles.device)

    def _measure_sleeping(self) -> None:
        """Measure the bounding boxes of sleeping regions, in which nothing moves."""
        self.boxes[:, 0], self.boxes[:, 1] = np.inf, -np.inf
        if self.asleep.any():
            self.measures.fill_(-np.inf)
            inputs = [self.particles.position, self.region, self.measures]
            device = self.particles.device
            wp.launch(measure_boxes, dim=self.particles.count, inputs=inputs, device=device)
            measures = self.measures.numpy()[0][self.asleep]
            self.boxes[self.asleep, 1] = measures[:, :3]
            self.boxes[self.asleep, 0] = -measures[:, 3:6]

    @property
    def fastest(self) -> float:
        """Speed of the fastest particle when last measured [m/s]."""
        return float(self.speed.max(initial=0.0))

    @property
    def box(self) -> NDArray[np.float64]:
        """Lowest and highest corner of all clay [m], shape [2, 3]."""
        return np.stack([self.boxes[:, 0].min(0), self.boxes[:, 1].max(0)])

    def measure(self, duration: float) -> None:
        """Measure boxes and speeds of awake particles, after a step of ``duration`` [s]."""
        if not self.particles.count:
            return
        self.measures.fill_(-np.inf)
        self.particles.run(
            measure_regions,
            regions_cpu.measure_regions,
            self.particles.position,
            self.particles.velocity,
            self.region,
            ByPart.rows(self.measures),
        )
        measures = self.measures.numpy().max(0)
        awake = ~self.asleep
        self.boxes[awake, 1] = measures[awake, :3]
        self.boxes[awake, 0] = -measures[awake, 3:6]
        self.speed[:] = 0.0
        self.speed[awake] = np.sqrt(np.maximum(measures[awake, 6], 0.0))
        self._find_awake_box()
        self._layout_travel += self.fastest * duration

    def doze(self, duration: float) -> NDArray[np.bool_]:
        """Update how long regions have been at rest, after a step of ``duration`` [s].

        Returns:
            The regions that should fall asleep now.
        """
        spacing = self.particles.spacing
        at_rest = self.speed < SLEEP_SPEED * spacing
        self.quiet = np.where(at_rest, self.quiet + duration, 0.0)
        self.travel += self.speed * duration
        if not self.sleeping:
            return np.zeros_like(self.asleep)
        # A region beside moving clay would only wake again.
        calm = ~self._spread(~at_rest & ~self.asleep)
        return ~self.asleep & calm & (self.quiet > SLEEP_DELAY)

    def disturbed(
        self, boxes: list[NDArray[np.float64]], unsupported: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Find the regions that must wake before the next step.

        Args:
            boxes: Boxes swept by moving colliders, shape [2, 3] each [m].
            unsupported: Whether each region has lost its support, shape [R].
        """
        moved = self.travel > WAKE_TRAVEL * self.particles.spacing
        wake = self._spread(moved) | unsupported
        self.travel[moved] = 0.0
        margin = 1.5 * self.particles.spacing
        for low, high in boxes:
            meets = (self.boxes[:, 0] < high + margin) & (self.boxes[:, 1] > low - margin)
            wake |= meets.all(1)
        wake &= self.asleep
        self.quiet[wake] = 0.0
        return wake

    def _spread(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Add the neighbors of the chosen regions."""
        grown = chosen.reshape(self.shape)
        for axis in range(3):
            along = np.moveaxis(grown.copy(), axis, 0)
            out = np.moveaxis(grown, axis, 0).copy()
            out[1:] |= along[:-1]
            out[:-1] |= along[1:]
            grown = np.moveaxis(out, 0, axis)
        return grown.ravel()

    def members(self, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Indices of the particles in some regions, ``chosen`` of shape [R]."""
        return np.flatnonzero(chosen[self.region.numpy()])

    def set_asleep(self, asleep: NDArray[np.bool_]) -> None:
        """Put regions to sleep or wake them.

        Args:
            asleep: Whether each region sleeps from now on, shape [R].
        """
        self.travel[asleep] = 0.0
        self.speed[asleep] = 0.0
        self.asleep = asleep
        self.generation += 1
        self._awake = ~asleep[self.region.numpy()]
        self.particles.set_awake(np.flatnonzero(self._awake))
        self._find_awake_box()

    def _find_awake_box(self) -> None:
        awake = self.boxes[~self.asleep]
        if len(awake):
            low, high = awake[:, 0].min(0), awake[:, 1].max(0)
            self.particles.awake_box = np.stack([low, high])

    def snapshot(self) -> dict[str, NDArray]:
        """Which particles sleep, and the layout of the regions."""
        return {
            "region_awake": self._awake.copy(),
            "region_of_particle": self.region.numpy().copy(),
            "region_shape": np.array(self.shape),
            "region_asleep": self.asleep.copy(),
            "region_quiet": self.quiet.copy(),
            "region_travel": self.travel.copy(),
            "region_boxes": self.boxes.copy(),
            "region_speed": self.speed.copy(),
            "region_way": np.array([self._layout_travel]),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
        self.generation += 1
        self._awake = state["region_awake"].copy()
        self.region.assign(state["region_of_particle"])
        self.shape = tuple(int(n) for n in state["region_shape"])
        for name in ("asleep", "quiet", "travel", "boxes", "speed"):
            setattr(self, name, state[f"region_{name}"].copy())
        self._layout_travel = float(state["region_way"][0])
        count = len(self.asleep)
        self.measures = self._make_measures(count)
        self.particles.set_awake(np.flatnonzero(self._awake))
        self._find_awake_box()
