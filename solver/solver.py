# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver: builds the passes a scene needs, and steps them."""

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .contact import ContactPass, MeshContacts, PlaneContacts, collide_meshes, collide_planes
from .damping import PieceDamping
from .diagnostics import Diagnostics
from .neighbors import Neighbors
from .plastic_bonds import BOND_REACH, BREAK_LENGTH, KERNEL_RADIUS, PlasticBonds
from .scene import MeshCollider, Plane, Scene
from .settings import Settings

BASE_STEP = 1.0 / 60.0
"""The step that `Settings.substeps` divides [s]."""
SKIN = 0.3
"""Extra reach of neighbour lists, in spacings."""
CHECK_SUBSTEPS = 8
"""Neighbour lists are looked after this often."""
SWEEP_LIMIT = 4
"""A collider that would take this many times the substeps jumps instead of sweeping."""


@wp.kernel(enable_backward=False)
def integrate(
    time_step: float,
    velocity: wp.array[wp.vec3],
    push: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    internal: wp.array[wp.vec2],
    quarantined: wp.array[int],
):
    """Move particles; one whose new state is not finite stays where it is, at rest."""
    i = wp.tid()
    moved = position[i] + velocity[i] * time_step + push[i]
    if wp.isfinite(moved) and wp.isfinite(internal[i]):
        position[i] = moved
    else:
        velocity[i] = wp.vec3()
        internal[i] = wp.vec2()
        wp.atomic_add(quarantined, 0, 1)
    push[i] = wp.vec3()


class Solver:
    """Simulates a scene of clay.

    The step follows algorithm 1 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with
    Virtual Clay*, WHC 2021 (predict, project, update velocities), in small steps: every substep
    runs each pass once (Macklin et al., *Small Steps in Physics Simulation*, SCA 2019,
    doi 10.1145/3309486.3340247).

    Example::

        scene = Scene(spacing=0.005)
        scene.add_clay(points, Material(yield_stress=5e3))
        floor = scene.add_plane((0, 0, 0), (0, 0, 1))
        solver = Solver(scene, Settings(), device="cpu")
        for frame in range(120):
            solver.step(1 / 60)
        print(solver.positions(), solver.force_on(floor))

    *Limitations*: elastic stiffness is capped by the substep (see `PlasticBonds`), so stiff clay
    springs back; friction has no memory, so a block held on an incline creeps by tenths of a
    millimetre a second; colliders push clay but do not yield to it.

    Args:
        scene: What is in it; clay and colliders added later are not seen.
        settings: How finely to work.
        device: Warp device, such as "cpu" or "cuda:0".

    Raises:
        ValueError: The device does not exist.
    """

    def __init__(
        self, scene: Scene, settings: Settings | None = None, device: str = "cpu"
    ) -> None:
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
        self._velocity_next = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self._internal = wp.zeros(count, dtype=wp.vec2, device=self.device)
        self._internal_next = wp.zeros(count, dtype=wp.vec2, device=self.device)
        self._push = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self._quarantined = wp.zeros(1, dtype=int, device=self.device)
        self._deepest = wp.zeros(1, dtype=float, device=self.device)
        self._clay = PlasticBonds(
            scene.spacing, scene.gravity, self._materials, self.settings, self.device
        )
        reach = max(KERNEL_RADIUS, BREAK_LENGTH) * scene.spacing
        self._neighbors = Neighbors(count, reach, SKIN * scene.spacing, self.device)
        if count:
            self._neighbors.rebuild(self._position)
            if self.settings.elastoplasticity:
                self._neighbors.bond_all(self._position, BOND_REACH * scene.spacing)
        self._damping = (
            PieceDamping(count, self.device)
            if self.settings.elastoplasticity and self.settings.viscosity and count
            else None
        )
        colliders: list[Plane | MeshCollider] = [*scene.planes, *scene.meshes]
        self._colliders = colliders
        self._planes = PlaneContacts(scene.planes, self.device) if scene.planes else None
        self._meshes = MeshContacts(scene.meshes, count, self.device) if scene.meshes else None
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
        substeps = max(1, math.ceil(self.settings.substeps * duration / BASE_STEP - 1e-6))
        if self._meshes:
            substeps = self._plan_colliders(substeps)
        time_step = duration / substeps
        self._clay.prepare(time_step, BASE_STEP / self.settings.substeps)
        common = ContactPass()
        common.time_step = time_step
        common.radius = 0.5 * self.scene.spacing
        self._impulse.zero_()
        self._deepest.zero_()
        for substep in range(substeps if self.scene.particle_count else 0):
            if substep % CHECK_SUBSTEPS == 0:
                self._neighbors.rebuild_if_moved(self._position)
            self._run_substep(common, substep, substeps)
        if self._damping:
            self._damping.apply(
                duration,
                self._neighbors,
                self._material,
                self._mass,
                self._position,
                self._velocity,
            )
        self.time += duration
        self._duration = duration
        self._substeps = substeps

    def _plan_colliders(self, substeps: int) -> int:
        """Substeps such that no collider moves more than half a particle's radius in one."""
        assert self._meshes is not None
        motions = self._meshes.farthest_motion()
        stride = 0.25 * self.scene.spacing
        most = SWEEP_LIMIT * substeps
        teleported = [motion > most * stride for motion in motions]
        swept = [m for m, jumps in zip(motions, teleported, strict=True) if not jumps]
        substeps = max(substeps, math.ceil(max(swept, default=0.0) / stride))
        self._teleported += sum(teleported)
        self._meshes.begin_step(substeps, motions, teleported)
        return substeps

    def _run_substep(self, common: ContactPass, substep: int, substeps: int) -> None:
        count = self.scene.particle_count
        self._clay.launch(
            self._material,
            self._position,
            self._velocity,
            self._internal,
            self._neighbors,
            self._velocity_next,
            self._internal_next,
        )
        self._velocity, self._velocity_next = self._velocity_next, self._velocity
        self._internal, self._internal_next = self._internal_next, self._internal
        if self._meshes:
            meshes = self._meshes
            meshes.begin_substep(substep, substeps)
            wp.launch(
                collide_meshes,
                dim=count,
                inputs=[
                    common,
                    substep,
                    len(self.scene.planes),
                    meshes.mesh,
                    meshes.pose,
                    meshes.orientation,
                    meshes.reach,
                    meshes.travel,
                    self._friction,
                    self._material,
                    self._mass,
                    self._position,
                    meshes.clearance,
                    self._velocity,
                    self._push,
                    self._impulse,
                    self._deepest,
                ],
                device=self.device,
            )
        if self._planes:
            wp.launch(
                collide_planes,
                dim=count,
                inputs=[
                    common,
                    self._planes.point,
                    self._planes.normal,
                    self._friction,
                    self._material,
                    self._mass,
                    self._position,
                    self._velocity,
                    self._push,
                    self._impulse,
                    self._deepest,
                ],
                device=self.device,
            )
        wp.launch(
            integrate,
            dim=count,
            inputs=[
                common.time_step,
                self._velocity,
                self._push,
                self._position,
                self._internal,
                self._quarantined,
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
            bulk = self._clay.bulk_modulus(self._material.numpy())
            compression = float((self._internal.numpy()[:, 1] / bulk).mean())
            speed = float(np.linalg.norm(self._velocity.numpy(), axis=1).max())
        return Diagnostics(
            time=self.time,
            particle_count=count,
            awake=count,
            substeps=self._substeps,
            volume_error=compression,
            max_penetration=float(self._deepest.numpy()[0]),
            max_speed=speed,
            clamped=int(self._clay.clamped.numpy()[0]),
            overflow=self._neighbors.overflow,
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
        if self._damping:
            passes.append("damping of pieces")
        held = sum(
            array.capacity
            for part in (self, self._neighbors, self._clay, self._damping, self._meshes)
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
            "internal": self._internal.numpy().copy(),
            "counts": np.array(
                [
                    int(self._clay.clamped.numpy()[0]),
                    int(self._quarantined.numpy()[0]),
                    self._teleported,
                ]
            ),
            **self._neighbors.snapshot(),
        }
        if self._damping:
            state.update(self._damping.snapshot())
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
        for name in ("position", "collider_clearance", "piece_label"):
            if name in own and own[name].shape != snapshot[name].shape:
                raise ValueError(
                    f"The snapshot has {name} of shape {snapshot[name].shape}, this scene "
                    f"{own[name].shape}: it is of another scene."
                )
        self.time = float(snapshot["time"])
        self._position.assign(snapshot["position"])
        self._velocity.assign(snapshot["velocity"])
        self._internal.assign(snapshot["internal"])
        clamped, quarantined, self._teleported = (int(n) for n in snapshot["counts"])
        self._clay.clamped.fill_(clamped)
        self._quarantined.fill_(quarantined)
        self._neighbors.restore(snapshot)
        if self._damping:
            self._damping.restore(snapshot)
        if self._meshes:
            self._meshes.restore(snapshot)
