# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording a live session: the motion of hands and tools, and the frames of the clay.

A background thread writes the take to a separate folder beside the bake during the recording, so a
crash loses at most the last two seconds. `finish` puts the take on the timeline, where it can be
played, and baked again with finer clay.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..base.preferences import ADDON_VERSION
from ..base.units import meters_per_unit
from ..core.storage.cache import Cache, CacheError, Meta
from ..core.take.data import TakeHeader, ToolShape
from ..core.take.files import write_header, write_start, write_tool
from ..core.take.frames import TakeFrames
from ..core.take.writer import TakeWriter
from ..model.cache_folder import CacheFolderError, owner_of, resolve_directory
from ..model.clay_scene import clay_colors, frames_per_second
from ..simulate.simulation import Simulation
from .pose import StepRow, read_poses, recorded_layout
from .steps import TakeSteps
from .store import StoredTake, store_take

if TYPE_CHECKING:
    from ..core.tools.settings import ToolMesh

_NUMBER = re.compile(r"(.*)_take_\d{3,}")


class TakeError(TactileClayError):
    """A take cannot be recorded or used; the message says why and what to do."""


class Mark(NamedTuple):
    """A moment in a take, for `TakeRecorder.rewind`."""

    seconds: float
    """Simulated time since the start of the take [s]."""
    edits: int
    """Edits made so far."""


class TakeRecorder:
    """Records a live session, from `begin` to `finish`.

    For each step of the session, call `capture` once the solver has its input, and `step` when it
    is done. Use the recorder in the main thread only. Recording does not wait for the disk.

    Args:
        scene: Scene of the session.
        simulation: Simulation of the session.
        directory: Folder of the take.
        header: Properties of the take.
    """

    def __init__(
        self, scene: bpy.types.Scene, simulation: Simulation, directory: Path, header: TakeHeader
    ) -> None:
        self.directory = directory
        self.header = header
        self.seconds = 0.0
        """Simulated time since the start of the take [s]."""
        self.warnings: list[str] = []
        """What the user should know about the take."""
        self._row: StepRow | None = None
        self._edits = 0
        self._tool_numbers: dict[bytes, int] = {}
        self._positions = simulation.positions()
        self._colors = simulation.colors
        layout = recorded_layout(scene)
        meta = Meta(
            start=header.frame_start,
            end=header.frame_start,
            frames_per_second=header.frames_per_second,
            clay=simulation.parts,
            settings={"take": directory.name},
            owner=owner_of(scene, Cache(directory)),
            version=ADDON_VERSION,
        )
        cache = Cache(directory)
        cache.begin(meta, self._colors)
        self._writer = TakeWriter()
        self._frames = TakeFrames(self._writer, cache, meta)
        self._steps = TakeSteps(directory, self._writer, layout)

    @classmethod
    def begin(
        cls, scene: bpy.types.Scene, simulation: Simulation, *, directory: Path | None = None
    ) -> TakeRecorder:
        """Start recording from the current state.

        Args:
            scene: Scene of the session.
            simulation: Simulation of the session; its solver is built, and idle.
            directory: An empty folder; by default a new one beside the scene's cache.

        Raises:
            TakeError: The folder cannot be created or written to, or the .blend was never saved.
        """
        try:
            folder = directory or new_directory(scene)
            layout = simulation.parts
            positions = layout.split(simulation.positions())
            colors = layout.split(simulation.colors)
            start = dict(zip(layout.names, zip(positions, colors, strict=True), strict=True))
            header = TakeHeader(
                frame_start=scene.frame_start,
                frames_per_second=frames_per_second(scene),
                unit_scale=meters_per_unit(scene),
                clay=tuple((p.name, p.count, float(simulation.spacing)) for p in simulation.parts),
            )
            folder.mkdir(parents=True, exist_ok=True)
            recorder = cls(scene, simulation, folder, header)
            try:
                write_start(folder, start)
                write_header(folder, header)
                recorder.capture(bpy.context.evaluated_depsgraph_get())
                recorder._take_row()
                recorder._frames.first(recorder._positions)
            except BaseException:
                recorder.close()
                raise
        except OSError as error:
            raise TakeError(f"{folder} cannot be created ({error.strerror or error}).") from error
        except (CacheFolderError, CacheError) as error:
            raise TakeError(str(error)) from error
        return recorder

    @property
    def problem(self) -> str:
        """Why nothing can be written at the moment; empty if all is well."""
        return self._writer.problem

    # During the recording -----------------------------------------------------------------------

    def use_tools(self, meshes: Sequence[ToolMesh]) -> None:
        """Set the tools moved with the mouse, recorded from now on."""
        numbers = []
        for mesh in meshes:
            tool = ToolShape(
                np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32), mesh.friction
            )
            key = tool.vertices.tobytes() + tool.faces.tobytes() + repr(tool.friction).encode()
            if key not in self._tool_numbers:
                number = self._tool_numbers[key] = len(self._tool_numbers)
                self._write(partial(write_tool, self.directory, number, tool))
            numbers.append(self._tool_numbers[key])
        if tuple(numbers) != self._steps.layout.tools:
            self._steps.set_layout(replace(self._steps.layout, tools=tuple(numbers)))
            self._row = None

    def capture(
        self,
        depsgraph: bpy.types.Depsgraph,
        tools: Sequence[tuple[NDArray[np.floating], bool]] = (),
    ) -> None:
        """Capture the poses for the next step, in the state that the solver was given.

        Args:
            depsgraph: The evaluated scene.
            tools: Transform from local to world space [m], shape [4, 4], of each mesh of
                `use_tools`, and whether it touches the clay.
        """
        try:
            self._row = read_poses(self._steps.layout, depsgraph, list(tools))
        except (LookupError, ReferenceError):
            # Colliders or hands were added or removed.
            self._steps.set_layout(
                recorded_layout(depsgraph.scene.original, self._steps.layout.tools)
            )
            self._row = read_poses(self._steps.layout, depsgraph, list(tools))

    def step(
        self,
        duration: float,
        positions: NDArray[np.floating],
        colors: NDArray[np.floating] | None = None,
    ) -> None:
        """Record the result of a step.

        Args:
            duration: Simulated duration [s].
            positions: World positions of all particles [Blender units], shape [N, 3].
            colors: Linear RGBA, shape [N, 4]; unchanged if not given.
        """
        if not duration > 0.0:
            return
        if self._row is None:
            idle = [(np.eye(4), False)] * len(self._steps.layout.tools)
            self.capture(bpy.context.evaluated_depsgraph_get(), idle)
        before, self._positions = self._positions, np.array(positions, np.float32)
        self._colors = self._colors if colors is None else np.array(colors, np.float32)
        began = self.seconds
        self.seconds = began + duration
        self._take_row()
        self._frames.step(began, duration, before, self._positions)

    def edit(self, kind: str, parameters: Mapping[str, Any]) -> None:
        """Record an edit of the clay; call `rebuilt` next.

        Args:
            kind: Kind of edit, an `EditKind`.
            parameters: Parameters, independent of the particle spacing: numbers, strings, or lists
                and arrays of them. Lengths in meters, world space.
        """
        self._edits += 1
        self._steps.event(
            {
                "event": "edit",
                "time": self.seconds,
                "kind": kind,
                "parameters": json.loads(json.dumps(dict(parameters), default=_to_json)),
            }
        )

    def rebuilt(self, simulation: Simulation) -> None:
        """Continue with a rebuilt solver, as after an edit.

        Raises:
            TakeError: The clay objects are different; the take is valid up to here.
        """
        names = [name for name, _, _ in self.header.clay]
        if [part.name for part in simulation.parts] != names:
            raise TakeError(
                "A clay object was added, renamed or deleted, so the take ends here: its clay "
                "objects must stay the same."
            )
        self._colors = simulation.colors
        positions = np.concatenate(simulation.rest).astype(np.float32)
        if len(positions) != len(self._positions):
            self._frames.replace(self._positions, positions, simulation.parts)
        self._positions = positions

    def mark(self) -> Mark:
        """The current moment, to store with an undo step for `rewind`."""
        return Mark(self.seconds, self._edits)

    def rewind(self, mark: Mark, simulation: Simulation) -> None:
        """Go back to an earlier moment after Undo, dropping all that came later from the take.

        Args:
            mark: Result of `mark`.
            simulation: The simulation after Undo.
        """
        self._edits = mark.edits
        self._steps.event({"event": "rewind", "time": mark.seconds, "edits": mark.edits})
        self.seconds = mark.seconds
        self._frames.rewind(mark.seconds)
        self.rebuilt(simulation)

    def _take_row(self) -> None:
        assert self._row is not None
        if self._steps.add(self._row, self.seconds):
            self._frames.write_end()
        self._row = None

    def _write(self, task: Callable[[], None]) -> None:
        # Ahead of waiting frames, which can be computed again.
        self._writer.do(task, first=True)

    # The end ------------------------------------------------------------------------------------

    def close(self) -> None:
        """Write as much as possible and end the thread; a second call does nothing."""
        with suppress(CacheError):
            self._writer.close()

    def abandon(self) -> None:
        """End a take whose scene was deleted. Its files can be opened with Recover Take."""
        try:
            self._steps.flush()
            self._frames.last(self.seconds, self._positions)
        finally:
            self.close()

    def finish(self, scene: bpy.types.Scene) -> StoredTake:
        """End the take and put it on the timeline.

        Hands and tools get keyframes, the frame range becomes that of the take, the clay at its
        start is stored in the .blend, and the frames of the clay are played back. The current frame
        becomes the last, which shows the clay at the end of the session.

        Args:
            scene: Scene of the session, which has ended and stored its clay.

        Raises:
            TakeError: Nothing was recorded.
        """
        self._steps.flush()
        self._frames.last(self.seconds, self._positions)
        header = replace(self.header, seconds=self.seconds)
        colors = self._painted_colors(scene)
        self._write(lambda: write_header(self.directory, header))
        self._write(lambda: Cache(self.directory).write_colors(colors))
        try:
            self._writer.close()
        except CacheError as error:
            self.warnings.append(
                f"{error} The motion of hands and tools is on the timeline nevertheless; Bake "
                "Again computes the frames of the clay."
            )
        if self.seconds == 0.0:
            raise TakeError("Nothing was recorded: no time was simulated.")
        stored = store_take(scene, self.directory, unwritten=self._steps.unwritten)
        return stored._replace(warnings=(*self.warnings, *stored.warnings))

    def _painted_colors(self, scene: bpy.types.Scene) -> NDArray[np.float32]:
        """Current colors of all particles in the scene, shape [N, 4]."""
        items = [scene.objects.get(name) for name, _, _ in self.header.clay]
        parts = [clay_colors(item) for item in items if item is not None]
        colors = np.concatenate([np.zeros((0, 4), np.float32), *parts])
        return colors if len(colors) == len(self._colors) else self._colors


def new_directory(scene: bpy.types.Scene) -> Path:
    """An unused folder for a new take, beside the scene's cache.

    Raises:
        CacheFolderError: The scene has no cache folder, or the .blend was never saved.
    """
    cache = resolve_directory(scene)
    match = _NUMBER.fullmatch(cache.name)
    base = match[1] if match else cache.name
    number = 1
    while (path := cache.parent / f"{base}_take_{number:03d}").exists():
        number += 1
    return path


def _to_json(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Sequence):
        return list(value)
    raise TypeError(f"The parameter {value!r} of an edit cannot be written to a file.")
