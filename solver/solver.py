# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver, which simulates a scene step by step."""

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .clay_model import ClayModel
from .colliders.contacts import Contacts
from .contact.law import MARGIN, ContactPass
from .core.memory import bytes_held
from .core.particles import Particles
from .core.recording_lock import alone
from .core.regions import Regions
from .description import passes_of
from .paper.model import PaperModel
from .plastic_bonds.model import PlasticBonds
from .scene.diagnostics import Diagnostics
from .scene.hand import Hand, HandContacts
from .scene.scene import MeshCollider, Plane, Scene
from .scene.settings import BASE_STEP, Settings
from .soft_hand.flesh import yielded_part
from .soft_hand.hold import held_part
from .soft_hand.soft_hand import SoftHand

CLAY_STRIDE = 0.5
"""Largest motion of clay in a substep, in spacings, so that no collision is missed."""
COLLIDER_STRIDE = 0.25
"""Largest motion of a collider along its normals in a substep, in spacings: half a radius."""
COLLIDER_SLIDE = 1.0
"""Largest motion of a collider along its surface near clay in a substep, in spacings."""
COLLIDER_TURN = 0.05
"""Largest rotation of a fast collider in a substep [rad]: the velocity of clay that it carries is
then correct to two thousandths."""
KEPT_EXCESS = 1.5
"""The previous number of substeps is kept if it is at most this many times the number needed."""
SWEEP_LIMIT = 32
"""A collider that would need more than this many times the substeps jumps instead of sweeping."""
MAX_SUBSTEPS = 128
"""Largest number of substeps in 1/60 s for fast clay."""
SPEED_FLOOR = 1.0
"""Speed that internal forces may always give clay [m/s]; see `Solver._limit_speed`."""
SPEED_MARGIN = 1.5
"""Multiple of the previous top speed that internal forces may give a particle: clay that spins,
bounces or whips trades speed between its parts, and clamping would cost momentum."""
_SURROUNDINGS = ("collider_", "contact_", "coarse_", "hand_", "region_")
"""Prefixes of snapshot entries that are not state of the clay, or follow from it."""
SPEED_MEMORY = 0.5
"""Time constant with which the recorded top speed decays [s]; it lets clay bounce back."""


class Solver:
    """Simulates a scene of clay.

    The step follows algorithm 1 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with
    Virtual Clay*, WHC 2021 (predict, project, update velocities), in a few small steps (Macklin et
    al., *Small Steps in Physics Simulation*, SCA 2019, doi 10.1145/3309486.3340247). What clay
    does in a substep is computed by a clay model, such as `PlasticBonds`.

    Example::

        scene = Scene(spacing=0.005)
        scene.add_clay(points, Material(yield_stress=5e3))
        floor = scene.add_plane((0, 0, 0), (0, 0, 1))
        solver = Solver(scene, Settings(), device="cpu")
        for frame in range(120):
            solver.step(1 / 60)
        print(solver.positions(), solver.force_on(floor))

    *Limitations*: the force of a press agrees with slip-line theory to 15 % if the tool's radius is
    at least three spacings, to a third at 2.4. Steady shear meets a tenth less resistance than
    the material specifies, and films of ten particles flow up to a fifth slower. Elastic clay
    bounces with a third of the speed it should at the live setting. Clay kneaded a hundred times
    loses some 5 % of the volume inside its surface. Bonds act between neighbors only, so Poisson's
    ratio is that of a central-force network and the pressure keeps the volume. Contact is a stiff
    penalty: under a fingertip particles enter a collider by a twentieth of the spacing, and a soft
    hand that is hit fast by up to their radius. Planes and meshes push clay but do not yield to it;
    hands do, some milliseconds late, and pass through planes, meshes, each other and themselves.
    Sleeping clay between awake clay and a collider does not transmit the force of a press. On a GPU
    the coarse matrix is inverted on the host; the solver has not been run on one.

    Args:
        scene: The scene; clay and colliders added to it later are ignored.
        settings: Resolution in time, and which parts of the model to use.
        device: Warp device, such as "cpu" or "cuda:0".

    Raises:
        ValueError: The device does not exist, or the clay model does not support hands.
    """

    @alone
    def __init__(self, scene: Scene, settings: Settings | None = None, device: str = "cpu") -> None:
        self.scene = scene
        self.settings = settings or Settings()
        try:
            self.device = wp.get_device(device)
        except (RuntimeError, ValueError) as error:
            known = ", ".join(str(d) for d in wp.get_devices())
            raise ValueError(f"There is no device {device!r}. Available: {known}.") from error
        if scene.hands and self.settings.model == "paper":
            raise ValueError(
                'The clay model "paper" does not support hands: use "plastic_bonds", or add the '
                "hand's skin as a mesh."
            )
        self.time = 0.0
        self._substeps = 0
        self._duration = BASE_STEP
        self._teleported = 0
        self.jumped: tuple[MeshCollider | Hand, ...] = ()
        """What moved too far to be swept in the last step, near clay: it jumped, and pushed none on
        its way."""
        self._begun = False
        initial = np.linalg.norm(scene.initial_velocities(), axis=1)
        self._speed_before = float(np.max(initial, initial=0.0))
        self._time_step_before = 0.0
        self._colors = scene.colors()
        self._particles = Particles(scene, self.device)
        self._contacts = Contacts(scene, self._particles, friction=self.settings.friction)
        model = PaperModel if self.settings.model == "paper" else PlasticBonds
        self._model: ClayModel = model(scene, self._particles, self._contacts, self.settings)
        sleeping = self.settings.sleeping and self._model.can_sleep
        self._regions = Regions(self._particles, sleeping=sleeping)

    def begin(self) -> None:
        """Start the motion of colliders and hands from where they were when the solver was made.

        Without this call they start where they are at the first step, and poses set before it are
        not motion. Call it right after making the solver if the poses set next are those at the end
        of the first step, as in a bake.
        """
        self._begun = True

    @alone
    def step(self, duration: float = BASE_STEP) -> None:
        """Advance by ``duration`` [s]; colliders reach their last set poses.

        Raises:
            ValueError: The duration is not a positive number.
        """
        if not (math.isfinite(duration) and duration > 0):
            raise ValueError(f"A step of {duration!r} s is not possible; it must be above 0.")
        base_substeps = max(1, math.ceil(self.settings.substeps * duration / BASE_STEP - 1e-6))
        speed = self._regions.fastest
        stride = CLAY_STRIDE * self.scene.spacing
        max_substeps = math.ceil(MAX_SUBSTEPS * duration / BASE_STEP)
        substeps = max(base_substeps, min(math.ceil(speed * duration / stride), max_substeps))
        motion = 0.0
        if self._contacts.meshes:
            substeps, motion = self._plan_colliders(base_substeps, substeps, duration)
        else:
            self._wake([])
            if substeps > base_substeps:
                substeps = self._reusable_substeps(substeps)
        self._limit_speed(speed, motion / duration, duration)
        time_step = duration / substeps
        self._contacts.begin_step()
        if not self._regions.asleep.all():
            self._model.begin_step()
            for substep in range(substeps):
                self._run_substep(time_step, substep, substeps)
            self._regions.measure(duration)
            self._doze(duration)
        elif self._hands:
            self._rest_on_hands(duration)
        for hand in self._hands:
            hand.end_step()
        self.time += duration
        self._duration = duration
        self._substeps = substeps
        self._begun = True

    def _wake(self, boxes: list[NDArray[np.float64]]) -> None:
        """Wake clay disturbed by other clay or by colliders that sweep ``boxes`` [m]."""
        regions = self._regions
        woken = regions.lay_out() if regions.outgrown else np.zeros(0, np.int64)
        wake = regions.disturbed(boxes, self._model.unsupported(regions))
        if wake.any():
            regions.asleep = regions.asleep & ~wake
            woken = np.union1d(woken, regions.members(wake))
        if len(woken):
            self._model.wake(woken)
            regions.set_asleep(regions.asleep)
            self._model.woken()

    def _doze(self, duration: float) -> None:
        """Put clay that has come to rest to sleep."""
        regions = self._regions
        falling_asleep = regions.doze(duration)
        if falling_asleep.any():
            resting = regions.members(falling_asleep)
            regions.set_asleep(regions.asleep | falling_asleep)
            self._model.rest(resting, self._time_step_before)

    def _limit_speed(self, speed: float, collider_speed: float, duration: float) -> None:
        """Limit the speed of particles in this step.

        Clay that overlaps itself, as when particles are added in one spot, holds far more elastic
        energy than real clay can. Only gravity and tools, which can throw it at twice their speed,
        make real clay faster than it was a moment ago.

        Args:
            speed: Speed of the fastest particle [m/s].
            collider_speed: Speed of the fastest collider [m/s].
            duration: Length of the step [s].
        """
        fall = 2.0 * float(np.linalg.norm(self.scene.gravity)) * duration
        thrown = max(SPEED_FLOOR, 2.0 * collider_speed)
        # Only external causes raise the limit, not the effect of internal forces.
        explained = min(speed, max(self._speed_before + fall, thrown))
        kept = max(explained, self._speed_before * math.exp(-duration / SPEED_MEMORY))
        self._speed_before = kept
        self._particles.speed_limit.fill_(max(SPEED_MARGIN * kept, thrown) + fall)

    @property
    def _hands(self) -> list[SoftHand]:
        meshes = self._contacts.meshes
        return meshes.hands if meshes else []

    def _rest_on_hands(self, duration: float) -> None:
        """Move hands while all clay sleeps, and let clay weigh on them."""
        for hand in self._hands:
            hand.begin_substep(0, 1, duration)
            hand.gather(self._contacts.slots, duration)

    def _plan_colliders(
        self, base_substeps: int, substeps: int, duration: float
    ) -> tuple[int, float]:
        """Choose the number of substeps so that no collider moves far into the clay in one.

        Returns:
            The number, and the largest motion of a collider that sweeps near the clay [m].
        """
        meshes = self._contacts.meshes
        assert meshes is not None
        stride = COLLIDER_STRIDE * self.scene.spacing
        if not self._begun:
            meshes.begin_here()
        motions, boxes = meshes.farthest_motion(stride * base_substeps)
        # The number of substeps bounds the motion of the clay towards a collider.
        reach = (2.0 + substeps) * self.scene.spacing
        low, high = self._regions.box + np.array([[-reach], [reach]])
        touched = self._regions.box + np.array([[-1.0], [1.0]]) * self.scene.spacing
        near = [bool((box[0] < high).all() and (box[1] > low).all()) for box in boxes]
        max_substeps = SWEEP_LIMIT * base_substeps
        teleported = [motion > max_substeps * stride for motion in motions]
        swept = []
        for index, motion in enumerate(motions):
            if near[index] and index < len(self.scene.meshes) and motion > stride * substeps:
                sweep = meshes.sweep(index, np.stack([low, high]), touched)
                # A large wheel does not jump, no matter how fast it turns.
                teleported[index] = sweep.along > max_substeps * stride
                slide = sweep.across * COLLIDER_STRIDE / COLLIDER_SLIDE
                turn = sweep.turn * stride / COLLIDER_TURN
                motion = max(sweep.along, min(max(slide, turn), max_substeps * stride))
            if near[index] and not teleported[index]:
                swept.append(motion)
        self._wake([box for motion, box in zip(motions, boxes, strict=True) if motion > 0.0])
        substeps = max(substeps, math.ceil(max(swept, default=0.0) / stride))
        if substeps > base_substeps:
            substeps = self._reusable_substeps(substeps)
        self._teleported += sum(teleported)
        moving: list[MeshCollider | Hand] = [*self.scene.meshes, *self.scene.hands]
        jumps = zip(moving, teleported, near, strict=True)
        self.jumped = tuple(collider for collider, jump, close in jumps if jump and close)
        meshes.begin_step(duration, substeps, motions, boxes, teleported, near)
        carried = zip(motions, teleported, near, strict=True)
        return substeps, max((m for m, jumps, close in carried if close and not jumps), default=0.0)

    def _reusable_substeps(self, substeps: int) -> int:
        """Return the previous number of substeps if it is sufficient and close, else round up.

        Passes are recorded for each length of substep, which costs as much as several frames.
        """
        before = self._substeps
        if substeps <= before <= KEPT_EXCESS * substeps:
            return before
        step = 1 << max(substeps.bit_length() - 3, 0)
        return -(-substeps // step) * step

    def _run_substep(self, time_step: float, substep: int, substeps: int) -> None:
        if self._contacts.meshes:
            self._contacts.meshes.begin_substep(substep, substeps, time_step)
        common = ContactPass()
        common.time_step = time_step
        common.time_step_before = self._time_step_before
        common.radius = 0.5 * self.scene.spacing
        common.margin = MARGIN * self.scene.spacing
        common.yielding = wp.vec2(yielded_part(time_step), held_part(time_step))
        self._model.run_substep(common)
        for hand in self._hands:
            hand.gather(self._contacts.slots, time_step)
            if substep == substeps - 1:
                hand.measure_compliance(self._contacts.slots)
        self._time_step_before = self._contacts.time_step = time_step

    def positions(self) -> NDArray[np.float32]:
        """Particle positions [m], shape [N, 3], in the order added."""
        return self._particles.position.numpy().copy()

    def velocities(self) -> NDArray[np.float32]:
        """Particle velocities [m/s], shape [N, 3], in the order added."""
        return self._particles.velocity.numpy().copy()

    def colors(self) -> NDArray[np.float32]:
        """Particle colors, linear RGBA in 0..1, shape [N, 4], in the order added."""
        return self._colors.copy()

    @alone
    def force_on(self, collider: Plane | MeshCollider | Hand) -> NDArray[np.float64]:
        """Force of the clay on a plane, mesh or hand [N], shape [3], mean over the last step.

        Raises:
            ValueError: The collider is not part of this solver's scene.
        """
        for hand in self._hands:
            if hand.hand is collider:
                return hand.force(self._duration)
        for index, known in enumerate(self._contacts.colliders):
            if known is collider:
                return self._contacts.force_on(index, self._duration)
        raise ValueError("That collider is not in the scene this solver was built from.")

    def penetrations(self) -> list[tuple[Plane | MeshCollider | Hand, float]]:
        """How deep clay lies in each collider that it touches [m], where it does."""
        return self._contacts.penetrations()

    @alone
    def contacts(self, hand: Hand) -> HandContacts:
        """Forces on the ghosts of a hand's skin, mean over the last step.

        They add up to `force_on` the hand, the reaction to its force on the clay. While a hand
        that jumped or was lost arrives, clay inside it is moved out gently; that is not reported
        as force.

        Raises:
            ValueError: The hand is not part of this solver's scene.
        """
        for known in self._hands:
            if known.hand is hand:
                return known.contacts(self._duration)
        raise ValueError("That hand is not in the scene this solver was built from.")

    @alone
    def diagnostics(self) -> Diagnostics:
        """Measurements of the last step, and counts since the start."""
        count = self.scene.particle_count
        compression = 0.0
        speed = 0.0
        if count:
            compression = float(self._model.compression().mean())
            speed = self._regions.fastest
        return Diagnostics(
            time=self.time,
            particle_count=count,
            awake=int(self._particles.awake.count.numpy()[0]),
            substeps=self._substeps,
            volume_error=compression,
            max_penetration=float(self._contacts.deepest.numpy().max()),
            max_speed=speed,
            clamped=int(self._particles.clamped.numpy().sum()),
            overflow=self._model.overflow,
            quarantined=int(self._particles.quarantined.numpy().sum()),
            teleported=self._teleported,
        )

    def describe(self) -> str:
        """Text about the passes that this scene needs, in order, and their memory."""
        passes = passes_of(self.scene, self._model.passes())
        held = bytes_held(self, set())
        lines = [
            f"{self.scene.particle_count} particles, {len(self._particles.mass)} materials, "
            f"model {self.settings.model}, device {self.device}",
            *(f"  {number}. {name}" for number, name in enumerate(passes, 1)),
            f"  {held / 1e6:.1f} MB on the device",
        ]
        return "\n".join(lines)

    def snapshot(self) -> dict[str, NDArray]:
        """All state that determines the next steps, as plain arrays.

        Restored into this solver, or into a new one built from an equal scene and settings on the
        same kind of device, the same steps give the same bits.
        """
        return {
            "time": np.array(self.time),
            "speed_before": np.array(self._speed_before),
            "time_step_before": np.array(self._time_step_before),
            "substeps": np.array(self._substeps),
            "teleported": np.array(self._teleported),
            **self._particles.snapshot(),
            **self._model.snapshot(),
            **self._contacts.snapshot(),
            **self._regions.snapshot(),
        }

    @alone
    def restore(self, snapshot: dict[str, NDArray]) -> None:
        """Restore a state returned by `snapshot`.

        Raises:
            ValueError: The snapshot is of another scene, or damaged. The state is unchanged.
        """
        own = self.snapshot()
        if set(own) != set(snapshot):
            raise ValueError("The snapshot is of a scene with other parts, or damaged.")
        for name in own:
            # The numbers of neighbors, cells and regions change from step to step.
            first = 1 if name.startswith(("neighbor_", "coarse_", "region_")) else 0
            if own[name].shape[first:] != snapshot[name].shape[first:]:
                raise ValueError(
                    f"The snapshot has {name} of shape {snapshot[name].shape}, this scene "
                    f"{own[name].shape}: it is of another scene."
                )
        self.time = float(snapshot["time"])
        self._speed_before = float(snapshot["speed_before"])
        self._time_step_before = float(snapshot["time_step_before"])
        self._contacts.time_step = self._time_step_before
        self._substeps = int(snapshot["substeps"])
        self._teleported = int(snapshot["teleported"])
        self._begun = True
        self._particles.restore(snapshot)
        self._regions.restore(snapshot)
        self._model.restore(snapshot)
        self._contacts.restore(snapshot)

    @alone
    def restore_clay(self, snapshot: dict[str, NDArray]) -> None:
        """Restore the clay from a snapshot, but not colliders and hands, which may differ.

        Args:
            snapshot: Snapshot of a solver with the same particles. All clay is awake afterwards.

        Raises:
            ValueError: It is of other clay, or damaged. The state is unchanged.
        """
        state = self.snapshot()
        for name in state:
            if not name.startswith(_SURROUNDINGS):
                if name not in snapshot:
                    raise ValueError(f"The snapshot has no {name}: it is of another solver.")
                state[name] = snapshot[name]
        begun = self._begun
        self.restore(state)
        # Colliders and hands are still where they were, and may not have begun to move.
        self._begun = begun
