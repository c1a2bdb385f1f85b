# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver: builds the passes a scene needs, and steps them."""

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .bond_law import (
    BOND_REACH,
    FORM_REACH,
    Body,
    Clay,
    PairLaw,
    make_bodies,
    make_clay,
    make_pair_laws,
)
from .coarse_space import CoarseSpace
from .colliders import MeshColliders, PlaneColliders
from .conjugate_gradients import ConjugateGradients
from .contact import (
    MARGIN,
    ContactPass,
    Contacts,
    find_mesh_contacts,
    find_plane_contacts,
    press_contacts,
    settle_contacts,
)
from .diagnostics import Diagnostics
from .neighbors import Neighbors
from .pairs import Pairs
from .recording import Recordings
from .scene import MeshCollider, Plane, Scene
from .settings import Settings

BASE_STEP = 1.0 / 60.0
"""The step that `Settings.substeps` divides [s]."""
SKIN = 0.75
"""Extra reach of neighbour lists, in spacings."""
SWEEP_LIMIT = 32
"""A collider that would take this many times the substeps jumps instead of sweeping."""
MOST_SUBSTEPS = 128
"""Fast clay takes at most this many substeps in 1/60 s."""
SPEED_FLOOR = 1.0
"""Inner forces may always make clay this fast [m/s]; see `Solver._limit_speed`."""
SPEED_MEMORY = 0.5
"""How long the clay may remember the speed it had, to bounce back with it [s]."""
MOST_LAWS = 64
"""Lengths of substep whose laws are kept."""
NEWTON_STEPS = 2
"""Linearisations in a substep: with one, bonds rupture; more change little (measured)."""


@wp.kernel(enable_backward=False)
def fall_freely(
    kick: wp.vec3,
    velocity: wp.array[wp.vec3],
    velocity_free: wp.array[wp.vec3],
    quarantined: wp.array[int],
) -> None:
    """Predict velocities without any inner or contact force.

    A velocity that is not finite is taken for rest: it must not reach the others.
    """
    i = wp.tid()
    if not wp.isfinite(velocity[i]):
        velocity[i] = wp.vec3()
        wp.atomic_add(quarantined, 0, 1)
    velocity_free[i] = velocity[i] + kick


@wp.kernel(enable_backward=False)
def move(
    time_step: float,
    velocity: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    speed_limit: wp.array[float],
    clamped: wp.array[int],
    quarantined: wp.array[int],
    substep: wp.array[int],
) -> None:
    """Move particles; one whose new state is not finite stays where it is, at rest."""
    i = wp.tid()
    if i == 0:
        substep[0] = substep[0] + 1
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


class Solver:
    """Simulates a scene of clay.

    The step follows algorithm 1 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with
    Virtual Clay*, WHC 2021 (predict, project, update velocities), in a few small steps (Macklin et
    al., *Small Steps in Physics Simulation*, SCA 2019, doi 10.1145/3309486.3340247). In place of
    local projections each substep solves for all velocities at once, by two Newton steps of
    conjugate gradients (Baraff and Witkin, *Large Steps in Cloth Simulation*, SIGGRAPH 1998,
    doi 10.1145/280814.280821): then clay carries its real stiffness, and weight, support and
    whole-body motion are exact.

    Example::

        scene = Scene(spacing=0.005)
        scene.add_clay(points, Material(yield_stress=5e3))
        floor = scene.add_plane((0, 0, 0), (0, 0, 1))
        solver = Solver(scene, Settings(), device="cpu")
        for frame in range(120):
            solver.step(1 / 60)
        print(solver.positions(), solver.force_on(floor))

    *Limitations*: the force of a press agrees with slip-line theory to about a fifth while it
    moves and falls by another tenth while it is held; slumps differ from theory by up to .16 of
    the height. Bonds act between neighbours only, so Poisson's ratio is that of a central-force
    network and the pressure keeps the volume. Contact is a stiff penalty: under a fingertip
    particles enter a collider by a twentieth of the spacing. Colliders push clay but do not yield
    to it. On a GPU the coarse matrix is inverted on the host, and no GPU has run it yet.

    Args:
        scene: What is in it; clay and colliders added later are not seen.
        settings: How finely to work.
        device: Warp device, such as "cpu" or "cuda:0".

    Raises:
        ValueError: The device does not exist.
    """

    def __init__(self, scene: Scene, settings: Settings | None = None, device: str = "cpu") -> None:
        self.scene = scene
        self.settings = settings or Settings()
        try:
            self.device = wp.get_device(device)
        except (RuntimeError, ValueError) as error:
            known = ", ".join(str(d) for d in wp.get_devices())
            raise ValueError(f"There is no device {device!r}. There are: {known}.") from error
        self.time = 0.0
        self._substeps = 0
        self._duration = BASE_STEP
        self._teleported = 0
        count = scene.particle_count
        self._materials, indices = scene.materials()
        self._colors = scene.colors()
        self._material = wp.array(indices, dtype=int, device=self.device)
        self._mass = wp.array(
            [m.density * scene.spacing**3 for m in self._materials], dtype=float, device=self.device
        )
        self._position = wp.array(scene.initial_positions(), dtype=wp.vec3, device=self.device)
        self._velocity = wp.array(scene.initial_velocities(), dtype=wp.vec3, device=self.device)
        self._velocity_free = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self._diagonal = wp.zeros(count, dtype=wp.mat33, device=self.device)
        self._own_block = wp.zeros(count, dtype=wp.mat33, device=self.device)
        self._clamped = wp.zeros(1, dtype=int, device=self.device)
        self._speed_limit = wp.zeros(1, dtype=float, device=self.device)
        self._speed_before = 0.0
        self._substep = wp.zeros(1, dtype=int, device=self.device)
        self._recordings = Recordings(self.device)
        self._quarantined = wp.zeros(1, dtype=int, device=self.device)
        self._deepest = wp.zeros(1, dtype=float, device=self.device)
        self._bodies = wp.array(
            make_bodies(self._materials, scene.spacing), dtype=Body, device=self.device
        )
        # Bonds stay listed however long they are; only those still to form must be found.
        reach = FORM_REACH * scene.spacing
        self._neighbors = Neighbors(count, reach, SKIN * scene.spacing, self.device)
        self._pairs = Pairs(count, self.device)
        self._gradients = ConjugateGradients(count, self.device)
        self._coarse = CoarseSpace(count, scene.spacing, self.device)
        self._time_step_before = 0.0
        self._laws: dict[float, tuple[Clay, wp.array]] = {}
        if count:
            self._neighbors.rebuild(self._position)
            if self.settings.elastoplasticity:
                self._neighbors.bond_all(self._position, BOND_REACH * scene.spacing)
        colliders: list[Plane | MeshCollider] = [*scene.planes, *scene.meshes]
        self._colliders = colliders
        self._contacts = Contacts(count, self.device) if colliders else None
        self._slots = self._contacts.slots if self._contacts else Contacts(0, self.device).slots
        self._least_mass = min((m.density for m in self._materials), default=1.0) * (
            scene.spacing**3
        )
        self._planes = PlaneColliders(scene.planes, self.device) if scene.planes else None
        self._meshes = MeshColliders(scene.meshes, count, self.device) if scene.meshes else None
        self._impulse = wp.zeros(len(colliders), dtype=wp.vec3d, device=self.device)
        self._friction = wp.array(self._friction_table(), dtype=float, device=self.device)

    def _friction_table(self) -> NDArray[np.float32]:
        """Friction of each material on each collider: the geometric mean of the two."""
        table = np.zeros((max(len(self._materials), 1), max(len(self._colliders), 1)), np.float32)
        if self.settings.friction:
            for row, material in enumerate(self._materials):
                for column, collider in enumerate(self._colliders):
                    table[row, column] = math.sqrt(material.friction * collider.friction)
        return table

    def step(self, duration: float = BASE_STEP) -> None:
        """Advance by ``duration`` [s]; colliders reach what was last set for them.

        Raises:
            ValueError: The duration is not a positive number.
        """
        if not (math.isfinite(duration) and duration > 0):
            raise ValueError(f"A step of {duration!r} s is not possible; it must be above 0.")
        shortest = max(1, math.ceil(self.settings.substeps * duration / BASE_STEP - 1e-6))
        speed = self._fastest()
        most = math.ceil(MOST_SUBSTEPS * duration / BASE_STEP)
        substeps = max(shortest, min(math.ceil(speed * duration / self.scene.spacing), most))
        motion = 0.0
        if self._meshes:
            substeps, motion = self._plan_colliders(shortest, substeps)
        self._limit_speed(speed, motion / duration, duration)
        time_step = duration / substeps
        self._prepare_law(time_step)
        self._impulse.zero_()
        self._deepest.zero_()
        self._substep.zero_()
        if self.scene.particle_count:
            self._coarse.place_cells(self._position)
            for substep in range(substeps):
                self._neighbors.rebuild_if_moved(self._position)
                self._run_substep(time_step, substep, substeps)
        self.time += duration
        self._duration = duration
        self._substeps = substeps

    def _fastest(self) -> float:
        """Speed of the fastest particle [m/s]."""
        speeds = np.linalg.norm(self._velocity.numpy(), axis=1)
        return float(np.max(speeds, initial=0.0, where=np.isfinite(speeds)))

    def _limit_speed(self, speed: float, collider_speed: float, duration: float) -> None:
        """Bound how fast anything can become in this step.

        Clay that overlaps itself, as when particles are added on one spot, holds far more elastic
        energy than clay can. Nothing that happens to clay makes it faster than it was a moment
        ago, but for gravity and for tools, which can throw it with twice their speed.

        Args:
            speed: Of the fastest particle [m/s].
            collider_speed: Of the fastest collider [m/s].
            duration: Length of the step [s].
        """
        kept = max(speed, self._speed_before * math.exp(-duration / SPEED_MEMORY))
        self._speed_before = kept
        fall = 2.0 * float(np.linalg.norm(self.scene.gravity)) * duration
        self._speed_limit.fill_(max(kept, SPEED_FLOOR, 2.0 * collider_speed) + fall)

    def _prepare_law(self, time_step: float) -> None:
        """Take up the laws for a substep; recordings hold on to those made before."""
        if time_step not in self._laws:
            if len(self._laws) >= MOST_LAWS:
                self._laws.clear()
                self._recordings.clear()
            scene = self.scene
            laws = make_pair_laws(self._materials, self.settings, scene.spacing, time_step)
            self._laws[time_step] = (
                make_clay(
                    self.settings, scene.spacing, scene.gravity, len(self._materials), time_step
                ),
                wp.array(laws, dtype=PairLaw, device=self.device),
            )
        self._clay, self._pair_laws = self._laws[time_step]

    def _plan_colliders(self, shortest: int, substeps: int) -> tuple[int, float]:
        """Substeps such that no collider near the clay moves more than half a particle's radius.

        Returns:
            Their number, and the farthest motion of a collider that sweeps near the clay [m].
        """
        assert self._meshes is not None
        motions, boxes = self._meshes.farthest_motion()
        points = self._position.numpy()
        points = points[np.isfinite(points).all(1)]
        # What the clay itself may move towards a collider meanwhile is bounded by its substeps.
        reach = (2.0 + substeps) * self.scene.spacing
        low = points.min(0, initial=np.inf) - reach
        high = points.max(0, initial=-np.inf) + reach
        near = [bool((box[0] < high).all() and (box[1] > low).all()) for box in boxes]
        stride = 0.25 * self.scene.spacing
        most = SWEEP_LIMIT * shortest
        teleported = [motion > most * stride for motion in motions]
        swept = [
            motion
            for motion, jumps, close in zip(motions, teleported, near, strict=True)
            if close and not jumps
        ]
        farthest = max(swept, default=0.0)
        substeps = max(substeps, math.ceil(farthest / stride))
        self._teleported += sum(teleported)
        self._meshes.begin_step(substeps, motions, teleported)
        return substeps, farthest

    def _run_substep(self, time_step: float, substep: int, substeps: int) -> None:
        """Gather pairs and contacts, solve for velocities, let bonds flow, move."""
        if self._meshes:
            self._meshes.begin_substep(substep, substeps)
        common = ContactPass()
        common.time_step = time_step
        common.time_step_before = self._time_step_before
        common.radius = 0.5 * self.scene.spacing
        common.margin = MARGIN * self.scene.spacing
        # Generations, not addresses: a new array may lie where an old one was.
        key = (
            time_step,
            self._time_step_before,
            self._coarse.generation,
            self._meshes.generation if self._meshes else 0,
        )
        self._recordings.run((*key, "open"), lambda: self._open_substep(common))
        self._coarse.invert(self._least_mass)
        self._recordings.run((*key, "close"), lambda: self._close_substep(common))
        self._time_step_before = time_step

    def _open_substep(self, common: ContactPass) -> None:
        """Everything up to the coarse matrix."""
        self._pairs.gather(self._clay, self._position, self._neighbors)
        # Velocities are those of the middle of a substep, so gravity acts from middle to middle:
        # free fall is exact whatever the substeps (leapfrog).
        kick = self._clay.gravity * (0.5 * (common.time_step + common.time_step_before))
        wp.launch(
            fall_freely,
            dim=self.scene.particle_count,
            inputs=[kick, self._velocity, self._velocity_free, self._quarantined],
            device=self.device,
        )
        if self._contacts:
            self._find_contacts(common)
        self._linearize(common)
        self._coarse.assemble(self._position, self._own_block, self._pairs)

    def _close_substep(self, common: ContactPass) -> None:
        """Newton's method, and what follows from the velocities it finds."""
        count = self.scene.particle_count
        for newton in range(NEWTON_STEPS):
            if newton > 0:
                self._linearize(common)
            self._gradients.solve(
                self.settings.iterations,
                self._clay,
                self._bodies,
                self._material,
                self._position,
                self._pairs,
                self._diagonal,
                self._own_block,
                self._coarse,
                self._velocity,
            )
        if self._contacts:
            wp.launch(
                settle_contacts,
                dim=count,
                inputs=[
                    common,
                    self._friction,
                    self._material,
                    self._velocity,
                    self._gradients.change,
                    self._contacts.slots,
                    self._impulse,
                    self._deepest,
                ],
                device=self.device,
            )
        self._pairs.measure(self._clay, self._velocity)
        self._pairs.flow(self._clay, self._pair_laws, self._material, self._neighbors)
        wp.launch(
            move,
            dim=count,
            inputs=[
                common.time_step,
                self._velocity,
                self._position,
                self._speed_limit,
                self._clamped,
                self._quarantined,
                self._substep,
            ],
            device=self.device,
        )

    def _find_contacts(self, common: ContactPass) -> None:
        assert self._contacts is not None
        count = self.scene.particle_count
        self._contacts.begin()
        if self._meshes:
            meshes = self._meshes
            wp.launch(
                find_mesh_contacts,
                dim=count,
                inputs=[
                    common,
                    self._substep,
                    len(self.scene.planes),
                    meshes.mesh,
                    meshes.pose,
                    meshes.orientation,
                    meshes.reach,
                    meshes.travel,
                    self._position,
                    self._velocity,
                    meshes.clearance,
                    self._contacts.slots,
                ],
                device=self.device,
            )
        if self._planes:
            wp.launch(
                find_plane_contacts,
                dim=count,
                inputs=[
                    common,
                    self._planes.point,
                    self._planes.normal,
                    self._position,
                    self._velocity,
                    self._contacts.slots,
                ],
                device=self.device,
            )

    def _linearize(self, common: ContactPass) -> None:
        """Residual and tangent of pairs and contacts at the present velocities."""
        count = self.scene.particle_count
        self._pairs.measure(self._clay, self._velocity)
        self._pairs.sum_forces(
            self._clay,
            self._pair_laws,
            self._bodies,
            self._material,
            self._velocity_free,
            self._velocity,
            self._gradients.residual,
            self._diagonal,
        )
        slots = self._slots
        wp.launch(
            press_contacts,
            dim=count,
            inputs=[
                common,
                self._friction,
                self._material,
                self._mass,
                self._velocity,
                slots,
                self._gradients.residual,
                self._diagonal,
                self._own_block,
            ],
            device=self.device,
        )

    def positions(self) -> NDArray[np.float32]:
        """Particle positions [m], shape [N, 3], in the order added."""
        return self._position.numpy().copy()

    def velocities(self) -> NDArray[np.float32]:
        """Particle velocities [m/s], shape [N, 3], in the order added."""
        return self._velocity.numpy().copy()

    def colors(self) -> NDArray[np.float32]:
        """Particle colours, linear RGBA in 0..1, shape [N, 4], in the order added."""
        return self._colors.copy()

    def force_on(self, collider: Plane | MeshCollider) -> NDArray[np.float64]:
        """Force of the clay on a plane or mesh [N], shape [3], mean over the last step.

        Raises:
            ValueError: The collider is not part of this solver's scene.
        """
        for which, known in enumerate(self._colliders):
            if known is collider:
                return self._impulse.numpy()[which] / self._duration
        raise ValueError("That collider is not in the scene this solver was built from.")

    def diagnostics(self) -> Diagnostics:
        """Figures of the last step and counts since the beginning."""
        count = self.scene.particle_count
        compression = 0.0
        speed = 0.0
        if count:
            compression = float(self._pairs.rows.compression.numpy().mean())
            speed = float(np.linalg.norm(self._velocity.numpy(), axis=1).max())
        return Diagnostics(
            time=self.time,
            particle_count=count,
            awake=count,
            substeps=self._substeps,
            volume_error=compression,
            max_penetration=float(self._deepest.numpy()[0]),
            max_speed=speed,
            clamped=int(self._clamped.numpy()[0]),
            overflow=self._neighbors.overflow + int(self._pairs.overflow.numpy()[0]),
            quarantined=int(self._quarantined.numpy()[0]),
            teleported=self._teleported,
        )

    def describe(self) -> str:
        """The passes that this scene needs, in order, and the memory they hold."""
        passes = ["neighbour lists", "bonds" if self.settings.elastoplasticity else "pressure"]
        if self._meshes:
            passes.append(f"contact with {len(self.scene.meshes)} meshes")
        if self._planes:
            passes.append(f"contact with {len(self.scene.planes)} planes")
        passes.append("motion")
        held = sum(
            array.capacity
            for part in (
                self,
                self._neighbors,
                self._pairs,
                self._gradients,
                self._coarse,
                self._meshes,
            )
            if part is not None
            for array in vars(part).values()
            if isinstance(array, wp.array)
        )
        lines = [
            f"{self.scene.particle_count} particles, {len(self._materials)} materials, "
            f"model {self.settings.model}, device {self.device}",
            *(f"  {number}. {name}" for number, name in enumerate(passes, 1)),
            f"  {held / 1e6:.1f} MB on the device",
        ]
        return "\n".join(lines)

    def snapshot(self) -> dict[str, NDArray]:
        """Everything that decides what the next steps do, as plain arrays.

        Restored into this solver, or into a new one built from an equal scene and settings on the
        same kind of device, the same steps give the same bits.
        """
        state = {
            "time": np.array(self.time),
            "position": self.positions(),
            "velocity": self.velocities(),
            "compression": self._pairs.rows.compression.numpy().copy(),
            "speed_before": np.array(self._speed_before),
            "time_step_before": np.array(self._time_step_before),
            "counts": np.array(
                [
                    int(self._pairs.overflow.numpy()[0]),
                    int(self._clamped.numpy()[0]),
                    int(self._quarantined.numpy()[0]),
                    self._teleported,
                ]
            ),
            **self._neighbors.snapshot(),
        }
        if self._contacts:
            state.update(self._contacts.snapshot())
        if self._meshes:
            state.update(self._meshes.snapshot())
        return state

    def restore(self, snapshot: dict[str, NDArray]) -> None:
        """Take up a state that `snapshot` gave.

        Raises:
            ValueError: The snapshot is of another scene, or damaged. The state stays as it is.
        """
        own = self.snapshot()
        if set(own) != set(snapshot):
            raise ValueError("The snapshot is of a scene with other parts, or damaged.")
        for name in own:
            # Rows of neighbours are cut to the widest.
            depth = 1 if name.startswith("neighbor_") else None
            if own[name].shape[:depth] != snapshot[name].shape[:depth]:
                raise ValueError(
                    f"The snapshot has {name} of shape {snapshot[name].shape}, this scene "
                    f"{own[name].shape}: it is of another scene."
                )
        self.time = float(snapshot["time"])
        self._position.assign(snapshot["position"])
        self._velocity.assign(snapshot["velocity"])
        self._pairs.rows.compression.assign(snapshot["compression"])
        self._time_step_before = float(snapshot["time_step_before"])
        overflow, clamped, quarantined, self._teleported = (int(n) for n in snapshot["counts"])
        self._speed_before = float(snapshot["speed_before"])
        self._clamped.fill_(clamped)
        self._pairs.overflow.fill_(overflow)
        self._quarantined.fill_(quarantined)
        self._neighbors.restore(snapshot)
        if self._contacts:
            self._contacts.restore(snapshot)
        if self._meshes:
            self._meshes.restore(snapshot)
