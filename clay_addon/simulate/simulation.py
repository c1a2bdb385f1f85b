# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of a Blender scene to a solver: clay, colliders, hands and settings."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.geometry.closed_mesh import MeshError
from ..base.mesh_geometry import (
    SWITCHED_OFF,
    is_absent,
    is_switched_off,
)
from ..base.units import meters_per_unit
from ..core.storage.clay_layout import ClayLayout, ClaySlice
from ..hands.hand import hand_objects
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
from ..model.collider import TAKE_TOOL
from ..model.digest import digest_of, scene_digests
from ..model.properties import frame_range
from .colliders import FlatCollider, MovingCollider, first_shown, read_collider
from .edited_clay import EditedClay
from .faults import Faults
from .hand_motion import HandState
from .scene_parts import check_clay, clay_there, common_spacing, read_hands

if TYPE_CHECKING:
    from ...solver import Scene, Solver

_HELD = "scene_hand_{}_held"
"""Key in a snapshot of the pose that a hand holds."""
_REFUSED = "The solver cannot take this scene: {}"


class Simulation:
    """A Blender scene ready to be simulated from the current frame.

    For a bake, the current frame must be the first one. The constructor checks the scene as far as
    possible; it does not start a solver.

    Args:
        context: Its scene is simulated.
        live: Whether this is a live session: clay starts in the shape shown, objects that are
            switched off in the viewport are left out, and hands give way to the clay.

    Raises:
        SimulationError: An object of the scene is unusable; the message says what to do.
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
        # Reading a hand temporarily changes the scene, so this precedes its evaluation.
        self.hands = read_hands(context, live=live)
        depsgraph = context.evaluated_depsgraph_get()
        clay = clay_there(clay_objects(scene), depsgraph, live=live)
        if not clay:
            raise SimulationError(
                "All clay in the scene is switched off in the viewport. Switch some of it on."
            )
        check_clay(clay, depsgraph)
        self.parts = ClayLayout(ClaySlice(item.name, len(item.data.points)) for item in clay)
        self.materials = tuple(checked_material(item) for item in clay)
        attribute = "position" if live else "rest_position"
        self.rest = [clay_positions(item, attribute) for item in clay]
        self.colors = np.concatenate([clay_colors(item) for item in clay])
        self.edited_clay: EditedClay | None = None
        """Edits to apply between frames; None if there are none."""
        if not live and scene.tactile_clay.film_edits:
            self.edited_clay = EditedClay(
                scene.tactile_clay.film_edits, clay, self.rest, self.scale
            )
        self.spacing = common_spacing(clay, self.scale)
        self.settings = solver_settings(scene)
        self.time_step = 1.0 / frames_per_second(scene)
        gravity = np.array(scene.gravity if scene.use_gravity else (0.0, 0.0, 0.0), np.float64)
        self.gravity = gravity * self.scale
        self._planes: list[FlatCollider] = []
        self._meshes: list[MovingCollider] = []
        self._surfaces: dict[str, dict[str, float]] = {}
        taking_part = [hand.item for hand in self.hands]
        self._absent = [i.name for i in hand_objects(scene) if i not in taking_part]
        """Colliders and hands that are off in the viewport, and so are not there."""
        self._add_colliders(context)
        self.solver: Solver | None = None
        self.faults = Faults()
        """What went wrong while it ran."""

    def _add_colliders(self, context: bpy.types.Context) -> None:
        """Add what is there now, or comes later by keys of its visibility."""
        scene = self.scene
        depsgraph = context.evaluated_depsgraph_get()
        names = [part.name for part in self.parts]
        clay = dict(zip(names, self.rest, strict=True))
        for item in collider_objects(scene):
            if self.live and TAKE_TOOL in item:
                continue
            if is_absent(item, depsgraph):
                if self.live or is_switched_off(item, depsgraph):
                    self._absent.append(item.name)
                    continue
                start = scene.frame_current
                _, end = frame_range(scene)
                appears = first_shown(item, scene, max(end, scene.frame_end))
                depsgraph = context.evaluated_depsgraph_get()
                if appears is not None:
                    self._add_collider(item, depsgraph, clay)
                scene.frame_set(start)
                depsgraph = context.evaluated_depsgraph_get()
                continue
            self._add_collider(item, depsgraph, clay)

    def _add_collider(
        self,
        item: bpy.types.Object,
        depsgraph: bpy.types.Depsgraph,
        clay: Mapping[str, NDArray[np.float32]],
    ) -> None:
        part = read_collider(item, depsgraph, clay, self.spacing)
        self._surfaces[item.name] = {
            "friction": item.tactile_clay.collider_friction,
            "adhesion": item.tactile_clay.collider_adhesion,
        }
        if isinstance(part, FlatCollider):
            self._planes.append(part)
        else:
            part.state(depsgraph)
            self._meshes.append(part)

    # Inputs of the result ---------------------------------------------------------------------

    def digests(self) -> dict[str, str]:
        """Digests of the inputs that determine the result, by subject."""
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
        """Possessive name of the parts that can move besides the clay, for messages."""
        if not self.hands:
            return "colliders'"
        return "colliders' or hands'" if self._meshes else "hands'"

    def measure_hands(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Compare the flesh of hands with what is shown of them now; `warnings` tells it."""
        with suppress(HandError):
            for hand in self.hands:
                hand.measure(depsgraph)

    def warnings(self) -> list[str]:
        """Warnings about hands and edits for the user."""
        warnings = [text for hand in self.hands for text in hand.warnings()]
        if self._absent:
            names = ", ".join(repr(name) for name in self._absent)
            warnings.append(
                f"{names} {'is' if len(self._absent) == 1 else 'are'} off in the viewport (the "
                "monitor, or a collection), so the clay does not meet "
                f"{'it' if len(self._absent) == 1 else 'them'}."
            )
        if self.edited_clay is not None and self.edited_clay.lost:
            warnings.append(
                f"{self.edited_clay.lost} particles could not be added: the clay moved more "
                "between strokes than expected."
            )
        warnings += self.faults.sentences()
        return warnings

    # Running ----------------------------------------------------------------------------------

    def start(self, depsgraph: bpy.types.Depsgraph, device: str) -> None:
        """Build the solver in its rest state, at the current frame.

        Args:
            depsgraph: The evaluated scene.
            device: Result of `solver_device`.

        Raises:
            SimulationError: The solver refuses the scene; the message says why.
        """
        self.build(self.prepare(depsgraph), device)

    def prepare(self, depsgraph: bpy.types.Depsgraph) -> Scene:
        """Create the solver's scene at the current frame.

        Raises:
            SimulationError: The solver refuses the scene; the message says why.
        """
        from ...solver import Scene

        try:
            scene = Scene(spacing=self.spacing * self.scale, gravity=self.gravity.tolist())
            for (points, colors), material in zip(self._bodies(), self.materials, strict=True):
                scene.add_clay(points.astype(np.float64) * self.scale, material, colors=colors)
            for plane in self._planes:
                surface = self._surfaces[plane.item.name]
                point = plane.point * self.scale
                plane.handle = scene.add_plane(point.tolist(), plane.normal.tolist(), **surface)
            for part in self._meshes:
                vertices, _ = part.state(depsgraph)
                surface = self._surfaces[part.item.name]
                part.handle = scene.add_mesh(vertices, part.triangles, **surface)
                part.handle.set_enabled(is_enabled(part.item, depsgraph))
            for hand in self.hands:
                hand.start(scene, depsgraph)
                if not self.live:
                    hand.measure(depsgraph)
            self.update(depsgraph)
        except HandError as error:
            raise SimulationError(str(error)) from error
        except (MeshError, ValueError) as error:
            raise SimulationError(_REFUSED.format(error)) from error
        return scene

    def _bodies(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """World positions [Blender units] and colors of the particles of each clay object."""
        if self.edited_clay is not None:
            return self.edited_clay.bodies()
        return list(zip(self.rest, self.parts.split(self.colors), strict=True))

    def build(self, scene: Scene, device: str) -> None:
        """Build the solver. This does not access Blender, so it can run in any thread.

        Args:
            scene: Result of `prepare`.
            device: Result of `solver_device`.

        Raises:
            SimulationError: The solver refuses the scene; the message says why.
        """
        from ...solver import Solver

        self._device = device
        try:
            self.solver = Solver(scene, self.settings, device=device)
            # From now on, a change of pose is motion.
            self.solver.begin()
        except (ValueError, RuntimeError) as error:
            raise SimulationError(_REFUSED.format(error)) from error

    def feed(self, depsgraph: bpy.types.Depsgraph) -> bytes:
        """Call `update` and return the digest of its result, 16 bytes."""
        return bytes.fromhex(digest_of(*self.update(depsgraph)))

    def update(self, depsgraph: bpy.types.Depsgraph) -> list[Any]:
        """Read colliders and hands at the current frame, and pass them to the solver if it runs.

        Returns:
            Their states, which determine the next step.

        Raises:
            SimulationError: A collider has changed in an unsupported way, or a hand is missing.
        """
        self._check_current(depsgraph)
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
        disabled = [index for index, touches in enumerate(enabled) if not touches]
        # The digests of existing bakes depend on this word.
        lifted = [("lifted", *disabled)] if disabled else []
        return [*states, *lifted, *self._feed_hands(depsgraph)]

    def _feed_hands(self, depsgraph: bpy.types.Depsgraph) -> list[HandState]:
        try:
            return [hand.feed(depsgraph) for hand in self.hands]
        except HandError as error:
            raise SimulationError(f"At frame {self.scene.frame_current}: {error}") from error

    def step(self, part: float = 1.0) -> None:
        """Advance the solver by a part of a frame, to the state passed on by `feed`."""
        assert self.solver is not None
        self.solver.step(part * self.time_step)
        self.note_faults()

    def advance_to(self, number: int, *, step_solver: bool) -> bytes:
        """Advance the scene to a frame from the previous one, through all motion samples.

        Args:
            number: The frame.
            step_solver: Whether to step the solver at each sample.

        Returns:
            Digest of the motion of colliders and hands, 16 bytes.

        Raises:
            SimulationError: A collider has changed in an unsupported way, or a hand is missing.
        """
        count = self.scene.tactile_clay.motion_samples
        digests = []
        for sample in range(1, count + 1):
            if sample < count:
                self.scene.frame_set(number - 1, subframe=sample / count)
            else:
                self.scene.frame_set(number)
            digests.append(self.feed(bpy.context.evaluated_depsgraph_get()))
            if step_solver:
                self.step(1.0 / count)
                self._edit(number - 1 + (sample - 1) / count, number - 1 + sample / count)
        return digests[0] if count == 1 else bytes.fromhex(digest_of(*digests))

    def _edit(self, after: float, until: float) -> None:
        """Apply the edits after one time and until another [frames]."""
        if self.edited_clay is None or not self.edited_clay.is_due(after, until):
            return
        assert self.solver is not None
        positions = (self.solver.positions() / self.scale).astype(np.float32)
        if self.edited_clay.apply(after, until, positions):
            self._rebuild()

    def _rebuild(self) -> None:
        self.build(self.prepare(bpy.context.evaluated_depsgraph_get()), self._device)

    def note_faults(self) -> None:
        """Take down what went wrong in the last step; `warnings` tells it."""
        assert self.solver is not None
        names = {id(part.handle): part.item.name for part in self._meshes}
        names |= {id(hand.handle): hand.item.name for hand in self.hands}
        names |= {id(part.handle): part.item.name for part in self._planes}
        frame = None if self.live else self.scene.frame_current
        self.faults.note(self.solver, names, self.spacing * self.scale, frame)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Full state of the simulation, as plain arrays."""
        assert self.solver is not None
        held = {_HELD.format(number): hand.held_pose() for number, hand in enumerate(self.hands)}
        edited = self.edited_clay.snapshot() if self.edited_clay is not None else {}
        return {**self.solver.snapshot(), **held, **edited}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state returned by `snapshot`, after `feed` at its frame.

        Raises:
            KeyError: A hand is missing in the state.
            ValueError: The state belongs to another scene, or is damaged.
        """
        assert self.solver is not None
        rest = dict(snapshot)
        # If the pose of a hand at this frame was dropped, the hand holds an earlier one.
        held = [rest.pop(_HELD.format(number)) for number in range(len(self.hands))]
        try:
            if self.edited_clay is not None:
                changed = self.edited_clay.restore(rest)
                rest = {k: v for k, v in rest.items() if not k.startswith("scene_edit_")}
                if changed:
                    self._rebuild()
            self.solver.restore(rest)
        except (KeyError, ValueError):
            if self.edited_clay is not None:
                self.edited_clay.begin()
                self._rebuild()
            raise
        for hand, bones in zip(self.hands, held, strict=True):
            hand.restore_pose(bones)

    def positions(self) -> NDArray[np.float32]:
        """World positions of all particles [Blender units], shape [N, 3]."""
        assert self.solver is not None
        positions = (self.solver.positions() / self.scale).astype(np.float32)
        return positions if self.edited_clay is None else self.edited_clay.expand(positions)

    def velocities(self) -> NDArray[np.float32]:
        """World velocities of all particles [Blender units/s], shape [N, 3]."""
        assert self.solver is not None
        velocities = (self.solver.velocities() / self.scale).astype(np.float32)
        return velocities if self.edited_clay is None else self.edited_clay.expand(velocities)

    def _check_current(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Refuse an evaluated scene that is not the current state of this scene."""
        if depsgraph.scene.original != self.scene:
            raise SimulationError(
                f"The active scene was changed during the simulation of {self.scene.name!r}. "
                "Activate that scene again, then press Resume."
            )
        colliders: list[FlatCollider | MovingCollider] = [*self._planes, *self._meshes]
        for item in (collider.item for collider in colliders):
            if is_switched_off(item, depsgraph):
                raise SimulationError(
                    f"At frame {self.scene.frame_current} {item.name!r} {SWITCHED_OFF}"
                )
