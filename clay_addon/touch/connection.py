# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch: the connection to an array server, and what the hands feel in each frame.

The server is a process of its own that ends with Blender. Everything here runs in Blender's main
thread and waits for nothing but the server's start.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.handlers import persistent
from numpy.typing import ArrayLike

from ...solver.core.errors import TactileClayError
from ..base.app_handlers import add_handlers, redraw_views, remove_handlers
from .array import placed_array
from .properties import device_name

if TYPE_CHECKING:
    from ...haptics import TransducerArray
    from ...haptics.array_server import ArrayClient, ArrayStatus
    from ...haptics.foci.pipeline import TouchFrame, TouchPipeline

_LOOK_EVERY = 0.25
"""The status is asked for this often [s]."""
_ANSWERS_WITHIN = 2.0
"""A server that was started by hand answers at once [s]."""
_PARTS = {"SONICSURFACE": "pyserial", "ULTRAINO": "pyserial", "OPENMPD": "pyusb", "AUTD3": "autd3"}
_MODULES = {"pyserial": "serial", "pyusb": "usb", "autd3": "autd3"}


class TouchError(TactileClayError):
    """Touch is not available; the message says why and what to do."""


def missing_touch_part(kind: str) -> str:
    """The package that a kind of device lacks, as a sentence; empty if it lacks none."""
    part = _PARTS.get(kind)
    if part is None:
        return ""
    found = False
    with suppress(ImportError, ValueError):
        found = importlib.util.find_spec(_MODULES[part]) is not None
    if found:
        return ""
    where = (
        "Install it, autd3-pattern and autd3-modulation into another Python with tactile-clay, run "
        "tactile-clay array-server autd3 there, and choose Running Server here"
        if part == "autd3"
        else "Install the extension from its zip for this platform, which brings it along"
    )
    return f"The package {part} is missing, which this array needs. {where}."


class TouchConnection:
    """The connection to an array server, and what is felt now."""

    def __init__(self) -> None:
        self.client: ArrayClient | None = None
        """The connection; None while there is none."""
        self.shown: TouchFrame | None = None
        """What is felt now, or would be if an array were connected."""
        self.status: ArrayStatus | None = None
        """What the server said last."""
        self._pipeline: TouchPipeline | None = None

    def connect(self, context: bpy.types.Context) -> None:
        """Start an array server for the scene's device, or connect to one that runs.

        Raises:
            TouchError: It does not start.
            TouchArrayError: The scene's array object is scaled.
        """
        self.disconnect()
        from ...haptics.array_server import ArrayClient, ArrayServerError

        properties = context.scene.tactile_touch
        missing = missing_touch_part(properties.kind)
        if missing:
            raise TouchError(missing)
        array = placed_array(context.scene)
        pose = None if array is None else array.pose
        if properties.kind == "SERVER":
            self.client = ArrayClient(properties.server_port, pose=pose)
            self.client.hello()
            found = self.read_status(wait=_ANSWERS_WITHIN)
            if found is None or not found.heard:
                self.disconnect()
                raise TouchError(
                    f"No array server answers at port {properties.server_port}. Start one with "
                    "tactile-clay array-server DEVICE."
                )
        else:
            try:
                self.client = ArrayClient.start(device_name(properties), pose=pose)
            except ArrayServerError as error:
                raise TouchError(str(error)) from error
        if not bpy.app.background:
            bpy.app.timers.register(_look, first_interval=_LOOK_EVERY)

    def disconnect(self) -> None:
        """Silence the array and end the server; does nothing where there is none."""
        if self.client is not None:
            self.client.close()
        self.client = self.status = None
        if bpy.app.timers.is_registered(_look):
            bpy.app.timers.unregister(_look)

    def touch_frame(
        self,
        scene: bpy.types.Scene,
        contacts: Sequence[Any],
        *,
        weights: Sequence[ArrayLike | None] = (),
        dt: float | None = None,
        taken: float | None = None,
        send: bool = True,
    ) -> TouchFrame | None:
        """Turn the contacts of a frame into touch; live sessions and bakes call it once a frame.

        Args:
            scene: Its array and settings count.
            contacts: ``solver.contacts(hand)`` of each hand, in meters and world coordinates.
            weights: Perceptual weights of each hand's ghosts.
            dt: Time since the last frame [s]; None after a jump.
            taken: When the contacts were taken, by `time.monotonic` [s]; now if not given.
            send: Whether it is sent to the array; a bake is not in real time and only records it.

        Returns:
            The frame, to be recorded with the bake; None where the scene has no array.

        Raises:
            TouchArrayError: The scene's array object is scaled.
        """
        begin = time.monotonic() if taken is None else taken
        array = placed_array(scene)
        if array is None:
            self.show(None)
            return None
        if self._pipeline is None:
            from ...haptics.foci.pipeline import TouchPipeline

            self._pipeline = TouchPipeline()
        properties = scene.tactile_touch
        frame = self._pipeline.step(
            contacts,
            array,
            weights=weights if properties.use_weights else (),
            dt=dt,
            gain=properties.gain,
            ceiling=properties.ceiling,
            count=properties.focus_count,
        )
        if send and self.client is not None:
            self._send(self.client, scene, frame, array, taken=begin)
        self.show(frame)
        return frame

    def feel(self, scene: bpy.types.Scene, frame: TouchFrame) -> None:
        """Send a recorded frame to the array if one is connected, and show it.

        Args:
            scene: Holds the array object and the modulation setting.
            frame: What to send.

        Raises:
            TouchArrayError: The scene's array object is scaled or sheared.
        """
        if self.client is not None:
            self._send(self.client, scene, frame, placed_array(scene))
        self.show(frame)

    def _send(
        self,
        client: ArrayClient,
        scene: bpy.types.Scene,
        frame: TouchFrame,
        array: TransducerArray | None,
        *,
        taken: float | None = None,
    ) -> None:
        from ...haptics.array_server import Modulation

        if array is not None:
            client.set_pose(array.pose)
        modulation = Modulation[scene.tactile_touch.modulation]
        client.send(frame.foci, modulation=modulation, time=taken)
        self.read_status()

    def show(self, frame: TouchFrame | None) -> None:
        """Show a frame in the overlay without sending it."""
        self.shown = frame

    def rest(self) -> None:
        """Silence the array and forget the previous frame, at the end of a live session."""
        self._pipeline = None
        self.show(None)
        if self.client is not None:
            self.client.silence()

    def read_status(self, *, wait: float = 0.0) -> ArrayStatus | None:
        """What the server says; None where none is connected.

        Args:
            wait: Wait up to this long [s] for something newer.
        """
        if self.client is not None:
            self.status = self.client.status(wait=wait)
        return self.status


touch = TouchConnection()
"""The connection of this Blender."""


def _look() -> float | None:
    """Ask for the status, and redraw the panels."""
    if touch.client is None:
        return None
    touch.client.hello()
    touch.read_status()
    redraw_views()
    return _LOOK_EVERY


@persistent
def _end_with_file(*_: object) -> None:
    touch.disconnect()
    touch.rest()


def register() -> None:
    """Let go of the array when another file is opened."""
    add_handlers((("load_pre", _end_with_file),))


def unregister() -> None:
    """Let go of the array."""
    _end_with_file()
    remove_handlers((("load_pre", _end_with_file),))
