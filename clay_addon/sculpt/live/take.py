# SPDX-License-Identifier: GPL-3.0-or-later
"""The take of a live session, if one is recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.storage.cache import CacheError
from ...core.tools.edits import Edit
from ...core.tools.settings import ToolMesh
from ...simulate.simulation import Simulation
from ...take.recorder import Mark, TakeError, TakeRecorder


class SessionTake:
    """Records a session from the first build of its solver, if the scene's *Record Take* is on.

    If the take cannot continue, it ends, but the session continues.

    Args:
        wanted: Whether to record.
    """

    def __init__(self, *, wanted: bool) -> None:
        self._wanted = wanted
        self._recorder: TakeRecorder | None = None
        self._ended: TakeRecorder | None = None
        self._start = Mark(0.0, 0)
        self.messages: list[str] = []
        """Messages about the take for the user, as sentences."""

    @property
    def mark(self) -> Mark | None:
        """The current moment of the take; None if none is being recorded."""
        return self._recorder.mark() if self._recorder is not None else None

    def begin(
        self, scene: bpy.types.Scene, simulation: Simulation, meshes: Sequence[ToolMesh]
    ) -> None:
        """Start recording if wanted and not started yet."""
        if not self._wanted:
            return
        self._wanted = False
        try:
            self._recorder = TakeRecorder.begin(scene, simulation)
        except TakeError as error:
            self.messages.append(f"No take is being recorded: {error}")
            return
        self._recorder.use_tools(meshes)
        self._start = self._recorder.mark()

    def look(
        self, depsgraph: bpy.types.Depsgraph, poses: Sequence[tuple[NDArray[np.float64], bool]]
    ) -> None:
        """Record the poses that the solver gets for its next step."""
        if self._recorder is not None:
            self._recorder.capture(depsgraph, poses)

    def step(self, duration: float, positions: NDArray[np.float32]) -> None:
        """Record the result of a step: world positions [Blender units], shape [N, 3]."""
        if self._recorder is not None:
            self._recorder.step(duration, positions)

    def edit(self, edits: Sequence[Edit]) -> None:
        """Record clay that was added, removed or painted."""
        if self._recorder is not None:
            for edit in edits:
                parameters = asdict(edit)
                self._recorder.edit(parameters.pop("kind"), parameters)

    def rebuilt(self, simulation: Simulation, meshes: Sequence[ToolMesh]) -> None:
        """Continue with a rebuilt solver."""
        if self._recorder is not None:
            self._recorder.use_tools(meshes)
            self._try(partial(self._recorder.rebuilt, simulation))

    def rewind(self, mark: Mark | None, simulation: Simulation) -> None:
        """Return to a moment, or to the start if it is unknown."""
        if self._recorder is not None:
            self._try(partial(self._recorder.rewind, mark or self._start, simulation))

    def finish(self, scene: bpy.types.Scene | None) -> bool:
        """End the take, and put it on the timeline.

        Args:
            scene: The session's scene; None if it is gone, and the take remains on disk only.

        Returns:
            Whether it is on the timeline.
        """
        recorder = self._recorder or self._ended
        self._recorder = self._ended = None
        if recorder is None:
            return False
        if scene is None:
            recorder.abandon()
            return False
        try:
            stored = recorder.finish(scene)
        except (TakeError, CacheError) as error:
            self.messages.append(str(error))
            return False
        finally:
            recorder.close()
        self.messages += stored.warnings
        self.messages.append(f"Take on frames {stored.first} to {stored.last}")
        return True

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except TakeError as error:
            self.messages.append(str(error))
            self._recorder, self._ended = None, self._recorder
