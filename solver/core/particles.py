# SPDX-License-Identifier: GPL-3.0-or-later
"""The particles of a scene on the device, which of them are awake, and how they fall and move."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from . import particles_cpu
from .awake import Awake, awake_particle
from .threads import helper_thread, processor_count
from .vector_units import BLOCK


@wp.kernel(enable_backward=False)
def fall_freely(
    awake: Awake,
    kick: wp.vec3,
    velocity: wp.array[wp.vec3],
    velocity_free: wp.array[wp.vec3],
    quarantined: wp.array[int],
) -> None:
    """Predict velocities without any internal or contact force.

    A velocity that is not finite is set to zero, so that it does not spread to other particles.
    """
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    if not wp.isfinite(velocity[i]):
        velocity[i] = wp.vec3()
        wp.atomic_add(quarantined, 0, 1)
    velocity_free[i] = velocity[i] + kick


@wp.kernel(enable_backward=False)
def move(
    awake: Awake,
    time_step: float,
    velocity: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    speed_limit: wp.array[float],
    clamped: wp.array[int],
    quarantined: wp.array[int],
) -> None:
    """Move particles; one whose new state is not finite stays where it is, at rest."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    speed = wp.length(velocity[i])
    if speed > speed_limit[0]:
        velocity[i] = velocity[i] * (speed_limit[0] / speed)
        wp.atomic_add(clamped, 0, 1)
    moved = position[i] + velocity[i] * time_step
    if wp.isfinite(moved):
        position[i] = moved
    else:
        velocity[i] = wp.vec3()
        wp.atomic_add(quarantined, 0, 1)


def zeros_with_room(count: int, dtype: Any, device: wp.Device) -> wp.array:
    """Zeros with room for one more at the end: vector units read four floats at a time."""
    return wp.zeros(count + 1, dtype=dtype, device=device)[:count]


class ByPart(list[Any]):
    """A list with one item for each part of the particles."""

    @classmethod
    def rows(cls, array: wp.array) -> ByPart:
        """The rows of an array, one for each part."""
        return cls([array[part] for part in range(array.shape[0])])


def _inputs_of_part(inputs: Sequence[Any], part: int) -> list[Any]:
    """Inputs for one part, which gets its own item of each `ByPart`."""
    return [item[part] if isinstance(item, ByPart) else item for item in inputs]


MIN_DIVIDED = 1024
"""Fewer particles than this are not worth dividing among threads."""


class HasDensity(Protocol):
    """The property of a material that particles need."""

    @property
    def density(self) -> float:
        """[kg/m³]"""


class ParticleSource(Protocol):
    """The source of particles: a `Scene`."""

    @property
    def particle_count(self) -> int:
        """Number of particles."""

    @property
    def spacing(self) -> float:
        """Particle spacing [m]."""

    @property
    def gravity(self) -> tuple[float, float, float]:
        """[m/s²]."""

    def materials(self) -> tuple[Sequence[HasDensity], NDArray[np.int32]]:
        """The different materials, and each particle's index among them, shape [N]."""

    def initial_positions(self) -> NDArray[np.float32]:
        """[m], shape [N, 3]."""

    def initial_velocities(self) -> NDArray[np.float32]:
        """[m/s], shape [N, 3]."""


class Particles:
    """The particles that every clay model works on.

    Args:
        source: Where particles, materials and gravity come from.
        device: Warp device.
    """

    def __init__(self, source: ParticleSource, device: wp.Device) -> None:
        self.device = device
        self.count = source.particle_count
        self.parts = 2 if device.is_cpu and self.count >= MIN_DIVIDED else 1
        """Number of parts that passes by block are split into, run in turn or in parallel."""
        self.spacing = source.spacing
        self.gravity = source.gravity
        materials, indices = source.materials()
        volume = source.spacing**3
        masses = [m.density * volume for m in materials]
        self.min_mass = min(masses, default=volume)
        """Smallest mass of a particle [kg]."""
        self.material = wp.array(indices, dtype=int, device=device)
        """Index of each particle's material."""
        self.mass = wp.array(masses, dtype=float, device=device)
        """Mass of a particle of each material [kg]."""
        self.position = zeros_with_room(self.count, wp.vec3, device)
        """[m]"""
        self.position.assign(source.initial_positions())
        self.velocity = zeros_with_room(self.count, wp.vec3, device)
        """[m/s], at the middle of a substep."""
        self.velocity.assign(source.initial_velocities())
        self.velocity_free = wp.zeros(self.count, dtype=wp.vec3, device=device)
        """Velocities to which only gravity has been applied in this substep [m/s]."""
        self.speed_limit = wp.zeros(1, dtype=float, device=device)
        self.clamped = wp.zeros((self.parts, 1), dtype=int, device=device)
        """How often a particle was slowed to the speed limit, by part."""
        self.quarantined = wp.zeros((self.parts, 1), dtype=int, device=device)
        """How often a particle's state was not finite, by part."""
        self.awake = self._make_share(0)
        self.threads = self.count
        """Number of threads in a pass, at least that of awake particles."""
        self.part: int | None = None
        """The only part to launch passes for, while they are recorded for one thread."""
        self._loaded: set[wp.Kernel] = set()
        self._barrier = wp.zeros(64, dtype=int, device=device)
        self._shares = [self._make_share(part) for part in range(self.parts)]
        self.resting = wp.zeros(self.count, dtype=int, device=device)
        """1 for a sleeping particle, else 0."""
        self.set_awake(np.arange(self.count))
        self.awake_box = self.box()
        """Lowest and highest corner of the awake particles [m], shape [2, 3]."""

    def set_awake(self, index: NDArray[np.int64]) -> None:
        """Set the particles that passes work on from now on.

        Args:
            index: Their indices, ascending.
        """
        shares = np.array_split(index, self.parts)
        for share, own in ((self.awake, index), *zip(self._shares, shares, strict=True)):
            padded = np.zeros(self.count, np.int32)
            padded[: len(own)] = own
            share.index.assign(padded)
            share.count.fill_(len(own))
        resting = np.ones(self.count, np.int32)
        resting[index] = 0
        self.resting.assign(resting)
        self._awake_index = index
        # Few distinct thread counts: each is recorded once, and idle blocks cost little.
        threads = MIN_DIVIDED
        while threads < len(index):
            threads *= 4
        self.threads = min(self.count, threads)

    def awake_index(self) -> NDArray[np.int64]:
        """Indices of the awake particles, ascending."""
        return self._awake_index

    def launch(self, kernel: wp.Kernel, *inputs: Any) -> None:
        """Run a pass over the particles that are awake; ``Awake`` is its first argument."""
        own = _inputs_of_part(inputs, self.awake.part)
        wp.launch(kernel, dim=self.threads, inputs=[self.awake, *own], device=self.device)

    def run(self, plain: wp.Kernel, by_block: wp.Kernel, *inputs: Any) -> None:
        """Run a pass with the kernel that suits the device.

        Args:
            plain: Kernel with one particle per thread, for GPUs.
            by_block: Kernel with one block per thread, for the CPU.
            inputs: Arguments of both kernels.
        """
        if self.device.is_cpu:
            self.launch_blocks(by_block, *inputs)
        else:
            self.launch(plain, *inputs)

    @contextmanager
    def only(self, part: int | None) -> Iterator[None]:
        """Launch passes for one part only; each waits for its counterparts."""
        self.part = part
        try:
            yield
        finally:
            self.part = None

    def _make_share(self, part: int) -> Awake:
        share = Awake()
        share.count = wp.zeros(1, dtype=int, device=self.device)
        share.index = wp.zeros(self.count, dtype=int, device=self.device)
        share.part = part
        return share

    def launch_blocks(self, kernel: wp.Kernel, *inputs: Any) -> None:
        """Run a pass with one block of particles per thread.

        Each part gets its own item of inputs that are `ByPart`.
        """
        part = -(-self.threads // self.parts)
        blocks = -(-part // BLOCK)
        self._launch_by_part(kernel, blocks, [ByPart(self._shares), *inputs])

    def launch_side_by_side(self, kernel: wp.Kernel, *inputs: Any) -> None:
        """Run a pass with one particle per thread, the parts in parallel on two processors.

        Threads must not read what others write. Must not be recorded.
        """
        threads = -(-self.threads // self.parts)

        def run(part: int) -> None:
            own = [self._shares[part], *_inputs_of_part(inputs, part)]
            wp.launch(kernel, dim=threads, inputs=own, device=self.device)

        if self.parts == 1 or processor_count() == 1 or kernel not in self._loaded:
            # The first launch loads the kernel's module: one thread must do that.
            self._loaded.add(kernel)
            self.launch(kernel, *inputs)
            return
        other = helper_thread().submit(run, 1)
        run(0)
        other.result()

    def launch_once(self, kernel: wp.Kernel, *inputs: Any) -> None:
        """Run a pass of a single thread once for each part."""
        self._launch_by_part(kernel, 1, list(inputs), wait=False)

    def _launch_by_part(
        self, kernel: wp.Kernel, dim: int, inputs: list[Any], *, wait: bool = True
    ) -> None:
        for part in range(self.parts) if self.part is None else (self.part,):
            wp.launch(kernel, dim=dim, inputs=_inputs_of_part(inputs, part), device=self.device)
        if self.part is not None and wait:
            meeting = [self._barrier, self.parts]
            wp.launch(particles_cpu.wait_for_others, dim=1, inputs=meeting, device=self.device)

    def zero(self, sums: ByPart) -> None:
        """Reset the sums of each part."""
        for part in range(self.parts) if self.part is None else (self.part,):
            sums[part].zero_()

    def fall_freely(self, time_step: float, time_step_before: float) -> None:
        """Set ``velocity_free``.

        Velocities belong to the middle of a substep, so gravity acts from middle to middle
        (leapfrog): free fall is exact for any substeps.
        """
        kick = wp.vec3(*self.gravity) * (0.5 * (time_step + time_step_before))
        self.run(
            fall_freely,
            particles_cpu.fall_freely,
            kick,
            self.velocity,
            self.velocity_free,
            ByPart.rows(self.quarantined),
        )

    def move(self, time_step: float) -> None:
        """Move particles by their velocities, no faster than the speed limit."""
        self.run(
            move,
            particles_cpu.move,
            time_step,
            self.velocity,
            self.position,
            self.speed_limit,
            ByPart.rows(self.clamped),
            ByPart.rows(self.quarantined),
        )

    def box(self) -> NDArray[np.float32]:
        """Lowest and highest corner of all particles [m], shape [2, 3]."""
        points = self.position.numpy()
        points = points[np.isfinite(points).all(1)]
        return np.stack([points.min(0, initial=np.inf), points.max(0, initial=-np.inf)])

    def snapshot(self) -> dict[str, NDArray]:
        """Positions, velocities and counts."""
        counts = [self.clamped.numpy().ravel(), self.quarantined.numpy().ravel()]
        return {
            "position": self.position.numpy().copy(),
            "velocity": self.velocity.numpy().copy(),
            "particle_faults": np.array(counts),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`."""
        self.position.assign(state["position"])
        self.velocity.assign(state["velocity"])
        clamped, quarantined = state["particle_faults"]
        self.clamped.assign(clamped.reshape(-1, 1))
        self.quarantined.assign(quarantined.reshape(-1, 1))
