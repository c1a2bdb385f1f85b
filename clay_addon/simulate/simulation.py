# SPDX-License-Identifier: GPL-3.0-or-later
"""From a Blender scene to a solver: clay, colliders, hands, and what decides the result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.geometry.closed_mesh import MeshError
from ...solver.geometry.rotations import rotation_and_stretch
from ..base.mesh_geometry import (
    SWITCHED_OFF,
    evaluated_mesh,
    flat_plane,
    is_switched_off,
    oriented_triangles,
    transform,
)
from ..base.units import meters_per_unit
from ..core.storage.clay_layout import ClayLayout, ClaySlice
from ..hands.reading import HandError
from ..model.clay_scene import (
    SimulationError,
    checked_material,
    clay_colors,
    clay_objects,
    clay_positions,
    collider_objects,
    frames_per_second,
    is_enabled,
    solver_settings,
)
from ..model.collider import ColliderError, resolve_kind
from ..model.digest import digest_of, scene_digests
from ..wheel.wheel import is_wheel
from .colliders import FlatCollider, MovingCollider
from .edited_clay import EditedClay
from .hand_motion import HandState
from .scene_parts import check_clay, common_spacing, read_hands, simulated

if TYPE_CHECKING:
    from ...solver import Scene, Solver

_HELD = "scene_hand_{}_held"
"""Key of the pose that a hand holds, in a snapshot."""
_REFUSED = "The solver cannot take this scene: {}"


class Simulation:
    """A Blender scene ready to be simulated, as it is at the current frame.

    For a bake the current frame must be the first one. Making it checks everything that can be
    checked and starts no solver yet.

    Args:
        context: Its scene is what is simulated.
        live: For a live session: clay starts as it is shown, what is switched off in the viewport
            is left out, and hands give way to the clay.

    Raises:
        SimulationError: Something in the scene is wrong; the message names the object and says
            what to do.
    """

    def __init__(
        self,
        context: bpy.types.Context,
        *,
        live: bool = False,
    ) -> None:
        scene = context.scene
        self.scene = scene
        self.scale = meters_per_unit(scene)
        self.live = live
        if not clay_objects(scene):
            raise SimulationError(
                "There is no clay in the scene. Select closed meshes and press Make Clay."
            )
        # Reading a hand changes the scene for a moment, so it comes before the evaluated scene.
        self.hands = read_hands(context, live=live)
        depsgraph = context.evaluated_depsgraph_get()
        clay = simulated(clay_objects(scene), depsgraph, live=live)
        if not clay:
            raise SimulationError(
                "All clay of the scene is switched off in the viewport. Switch some of it on."
            )
        check_clay(clay, depsgraph)
        self.parts = ClayLayout(ClaySlice(item.name, len(item.data.points)) for item in clay)
        self.materials = tuple(checked_material(item) for item in clay)
        attribute = "position" if live else "rest_position"
        self.rest = [clay_positions(item, attribute) for item in clay]
        self.colors = np.concatenate([clay_colors(item) for item in clay])
        self.edited: EditedClay | None = None
        """Edits that are carried out between frames; None where there are none."""
        if not live and scene.tactile_clay.film_edits:
            self.edited = EditedClay(scene.tactile_clay.film_edits, clay, self.rest, self.scale)
        self.spacing = common_spacing(clay, self.scale)
        self.settings = solver_settings(scene)
        self.time_step = 1.0 / frames_per_second(scene)
        gravity = np.array(scene.gravity if scene.use_gravity else (0.0, 0.0, 0.0), np.float64)
        self.gravity = gravity * self.scale
        self._planes: list[FlatCollider] = []
        self._meshes: list[MovingCollider] = []
        self._surfaces: dict[str, dict[str, float]] = {}
        middle = np.concatenate(self.rest).astype(np.float64).mean(0)
        for item in simulated(collider_objects(scene), depsgraph, live=live):
            self._add_collider(item, depsgraph, middle)
        self.solver: Solver | None = None

    def _add_collider(
        self,
        item: bpy.types.Object,
        depsgraph: bpy.types.Depsgraph,
        middle: NDArray[np.float64],
    ) -> None:
        try:
            kind = resolve_kind(item, item.tactile_clay.collider_kind, depsgraph)
        except ColliderError as error:
            raise SimulationError(str(error)) from error
        vertices, triangles = evaluated_mesh(item, depsgraph)
        matrix = np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
        if kind == "PLANE" and is_wheel(item):
            raise SimulationError(
                f"{item.name!r} has a wheel speed, but an endless plane stands still. Set the "
                "speed to 0, or give it thickness (Solidify modifier), so that it is a closed mesh."
            )
        self._surfaces[item.name] = {
            "friction": item.tactile_clay.collider_friction,
            "adhesion": item.tactile_clay.collider_adhesion,
        }
        if kind == "MESH":
            _, stretch = rotation_and_stretch(matrix[:3, :3])
            self._meshes.append(
                MovingCollider(item, vertices, oriented_triangles(matrix, triangles), stretch)
            )
            return
        flat = flat_plane(transform(matrix, vertices))
        assert flat is not None
        point, normal = flat
        # The free side of a table is the side the clay is on, whichever way its face is turned.
        side = float(normal @ (middle - point))
        if abs(side) < 1e-9:
            side = normal[2]
        self._planes.append(FlatCollider(item, point, normal if side >= 0 else -normal))

    # What decides the result ------------------------------------------------------------------

    def digests(self) -> dict[str, str]:
        """A digest for each subject that decides the result, to tell which one has changed."""
        return {
            **scene_digests(self.scene),
            "colliders": digest_of(
                tuple(self._surfaces.values()),
                *((part.point, part.normal) for part in self._planes),
                *((part.vertices, part.triangles, part.stretch) for part in self._meshes),
            ),
            "hands": digest_of(*(hand.digest_parts() for hand in self.hands)),
        }

    def moving_parts(self) -> str:
        """What can move in this scene besides the clay, as a possessive."""
        if not self.hands:
            return "colliders'"
        return "colliders' or hands'" if self._meshes else "hands'"

    def warnings(self) -> list[str]:
        """What the user should know about hands and edits."""
        warnings = [text for hand in self.hands for text in hand.warnings()]
        if self.edited is not None and self.edited.lost:
            warnings.append(
                f"{self.edited.lost} particles of added clay found no room: the clay moved more "
                "between strokes than was foreseen."
            )
        return warnings

    # Running ----------------------------------------------------------------------------------

    def start(self, depsgraph: bpy.types.Depsgraph, device: str) -> None:
        """Build the solver in its rest state, at the current frame.

        Args:
            depsgraph: The evaluated scene.
            device: What `solver_device` gave.

        Raises:
            SimulationError: The solver refuses the scene; the message says why.
        """
        self.build(self.prepare(depsgraph), device)

    def prepare(self, depsgraph: bpy.types.Depsgraph) -> Scene:
        """Say what is in the solver's scene, at the current frame.

        Raises:
            SimulationError: The solver refuses it; the message says why.
        """
        from ...solver import Scene

        try:
            scene = Scene(spacing=self.spacing * self.scale, gravity=self.gravity.tolist())
            for (points, colors), material in zip(self._bodies(), self.materials, strict=True):
                scene.add_clay(points.astype(np.float64) * self.scale, material, colors=colors)
            for plane in self._planes:
                surface = self._surfaces[plane.item.name]
                point = plane.point * self.scale
                scene.add_plane(point.tolist(), plane.normal.tolist(), **surface)
            for part in self._meshes:
                vertices, _ = part.state(depsgraph)
                surface = self._surfaces[part.item.name]
                part.handle = scene.add_mesh(vertices, part.triangles, **surface)
                part.handle.set_enabled(is_enabled(part.item, depsgraph))
            for hand in self.hands:
                hand.start(scene, depsgraph)
            self.follow(depsgraph)
        except HandError as error:
            raise SimulationError(str(error)) from error
        except (MeshError, ValueError) as error:
            raise SimulationError(_REFUSED.format(error)) from error
        return scene

    def _bodies(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """World positions [Blender units] and colors of each clay object's particles."""
        if self.edited is not None:
            return self.edited.bodies()
        return list(zip(self.rest, self.parts.split(self.colors), strict=True))

    def build(self, scene: Scene, device: str) -> None:
        """Build the solver; this needs no Blender, so any thread may do it.

        Args:
            scene: What `prepare` gave.
            device: What `solver_device` gave.

        Raises:
            SimulationError: The solver refuses the scene; the message says why.
        """
        from ...solver import Solver

        self._device = device
        try:
            self.solver = Solver(scene, self.settings, device=device)
            # The next poses are those of the next moment: what lies between is motion.
            self.solver.begin()
        except (ValueError, RuntimeError) as error:
            raise SimulationError(_REFUSED.format(error)) from error

    def feed(self, depsgraph: bpy.types.Depsgraph) -> bytes:
        """Do as `follow`, and return sixteen bytes that say what colliders and hands do."""
        return bytes.fromhex(digest_of(*self.follow(depsgraph)))

    def follow(self, depsgraph: bpy.types.Depsgraph) -> list[Any]:
        """Tell the solver, if it runs, where colliders and hands are at the current frame.

        Returns:
            What they do: all that decides the next step.

        Raises:
            SimulationError: A collider did what a solver cannot follow, or a hand is gone.
        """
        self._check_followed(depsgraph)
        for plane in self._planes:
            plane.check(depsgraph, self.spacing)
        states = [part.state(depsgraph) for part in self._meshes]
        enabled = [is_enabled(part.item, depsgraph) for part in self._meshes]
        for part, (vertices, pose), touches in zip(self._meshes, states, enabled, strict=True):
            if part.handle is None:
                continue
            part.handle.set_enabled(touches)
            try:
                if not np.array_equal(vertices, part.handle.vertices):
                    part.handle.set_vertices(vertices)
                part.handle.set_pose(pose)
            except ValueError as error:
                raise SimulationError(
                    f"{part.item.name!r} at frame {self.scene.frame_current}: {error}"
                ) from error
        lifted = [index for index, touches in enumerate(enabled) if not touches]
        said = [("lifted", *lifted)] if lifted else []
        return [*states, *said, *self._feed_hands(depsgraph)]

    def _feed_hands(self, depsgraph: bpy.types.Depsgraph) -> list[HandState]:
        try:
            return [hand.feed(depsgraph) for hand in self.hands]
        except HandError as error:
            raise SimulationError(f"At frame {self.scene.frame_current}: {error}") from error

    def step(self, part: float = 1.0) -> None:
        """Advance by a part of a frame, to where `feed` put the colliders."""
        assert self.solver is not None
        self.solver.step(part * self.time_step)

    def reach(self, number: int, *, steps: bool) -> bytes:
        """Bring the scene to a frame from the one before, through the moments between them.

        Args:
            number: The frame.
            steps: Whether the solver steps on to each moment.

        Returns:
            Sixteen bytes that say what colliders and hands did.

        Raises:
            SimulationError: A collider did what a solver cannot follow, or a hand is gone.
        """
        count = self.scene.tactile_clay.motion_samples
        done = []
        for sample in range(1, count + 1):
            if sample < count:
                self.scene.frame_set(number - 1, subframe=sample / count)
            else:
                self.scene.frame_set(number)
            done.append(self.feed(bpy.context.evaluated_depsgraph_get()))
            if steps:
                self.step(1.0 / count)
                self._edit(number - 1 + (sample - 1) / count, number - 1 + sample / count)
        return done[0] if count == 1 else bytes.fromhex(digest_of(*done))

    def _edit(self, after: float, until: float) -> None:
        """Carry out the edits between two moments [frames]."""
        if self.edited is None or not self.edited.is_due(after, until):
            return
        assert self.solver is not None
        positions = (self.solver.positions() / self.scale).astype(np.float32)
        if self.edited.apply(after, until, positions):
            self._rebuild()

    def _rebuild(self) -> None:
        self.build(self.prepare(bpy.context.evaluated_depsgraph_get()), self._device)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Everything that decides what the next steps do, as plain arrays."""
        assert self.solver is not None
        held = {_HELD.format(number): hand.held() for number, hand in enumerate(self.hands)}
        edited = self.edited.snapshot() if self.edited is not None else {}
        return {**self.solver.snapshot(), **held, **edited}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state that `snapshot` gave, after `feed` at its frame.

        Raises:
            KeyError: A hand is missing in it.
            ValueError: It is of another scene, or damaged.
        """
        assert self.solver is not None
        rest = dict(snapshot)
        # At the frame itself a hand may have a pose that was dropped, and hold an earlier one.
        held = [rest.pop(_HELD.format(number)) for number in range(len(self.hands))]
        try:
            if self.edited is not None:
                changed = self.edited.restore(rest)
                rest = {k: v for k, v in rest.items() if not k.startswith("scene_edit_")}
                if changed:
                    self._rebuild()
            self.solver.restore(rest)
        except (KeyError, ValueError):
            if self.edited is not None:
                self.edited.begin()
                self._rebuild()
            raise
        for hand, bones in zip(self.hands, held, strict=True):
            hand.hold(bones)

    def positions(self) -> NDArray[np.float32]:
        """World positions [Blender units], shape [N, 3]."""
        assert self.solver is not None
        positions = (self.solver.positions() / self.scale).astype(np.float32)
        return positions if self.edited is None else self.edited.spread(positions)

    def velocities(self) -> NDArray[np.float32]:
        """World velocities [Blender units/s], shape [N, 3]."""
        assert self.solver is not None
        velocities = (self.solver.velocities() / self.scale).astype(np.float32)
        return velocities if self.edited is None else self.edited.spread(velocities)

    def _check_followed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Refuse a state that Blender has not brought to the current frame."""
        if depsgraph.scene.original != self.scene:
            raise SimulationError(
                f"Another scene was chosen while {self.scene.name!r} was simulated. Choose that "
                "one again, then Resume."
            )
        followed: list[FlatCollider | MovingCollider] = [*self._planes, *self._meshes]
        for item in (part.item for part in followed):
            if is_switched_off(item, depsgraph):
                raise SimulationError(
                    f"At frame {self.scene.frame_current} {item.name!r} {SWITCHED_OFF}"
                )
