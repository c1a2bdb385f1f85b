# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection to an array server, and the focal points of the current frame.

The server is a separate process that ends with Blender. Everything here runs in Blender's main
thread and only waits for the start of the server.
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

_STATUS_INTERVAL = 0.25
"""Interval at which the status is requested [s]."""
_ANSWER_TIMEOUT = 2.0
"""Maximum time to wait for a server started from the command line [s]."""
_PACKAGES = {
    "SONICSURFACE": "pyserial",
    "ULTRAINO": "pyserial",
    "OPENMPD": "pyusb",
    "AUTD3": "autd3",
}
_MODULES = {"pyserial": "serial", "pyusb": "usb", "autd3": "autd3"}


class TouchError(TactileClayError):
    """Touch is not available; the message says why and what to do."""


def missing_touch_package(kind: str) -> str:
    """A message about the package that a kind of device needs but lacks; empty if none."""
    package = _PACKAGES.get(kind)
    if package is None:
        return ""
    found = False
    with suppress(ImportError, ValueError):
        found = importlib.util.find_spec(_MODULES[package]) is not None
    if found:
        return ""
    remedy = (
        "Install it, autd3-pattern and autd3-modulation into another Python with tactile-clay, run "
        "tactile-clay array-server autd3 there, and choose Running Server here"
        if package == "autd3"
        else "Install the extension from its zip for this platform, which includes it"
    )
    return f"This array needs the package {package}, which is missing. {remedy}."


class TouchConnection:
    """The connection to an array server, and the current frame of touch."""

    def __init__(self) -> None:
        self.client: ArrayClient | None = None
        """The connection; None if not connected."""
        self.shown: TouchFrame | None = None
        """The current frame, whether or not an array is connected."""
        self.status: ArrayStatus | None = None
        """The server's latest status."""
        self._pipeline: TouchPipeline | None = None

    def connect(self, context: bpy.types.Context) -> None:
        """Start an array server for the scene's device, or connect to a running one.

        Raises:
            TouchError: The server does not start or answer.
            TouchArrayError: The scene's array object is scaled or sheared.
        """
        self.disconnect()
        from ...haptics.array_server import ArrayClient, ArrayServerError

        properties = context.scene.tactile_touch
        missing = missing_touch_package(properties.kind)
        if missing:
            raise TouchError(missing)
        array = placed_array(context.scene)
        pose = None if array is None else array.pose
        if properties.kind == "SERVER":
            self.client = ArrayClient(properties.server_port, pose=pose)
            self.client.hello()
            status = self.read_status(wait=_ANSWER_TIMEOUT)
            if status is None or not status.heard:
                self.disconnect()
                raise TouchError(
                    f"No array server answers on port {properties.server_port}. Start one with "
                    "tactile-clay array-server DEVICE."
                )
        else:
            try:
                self.client = ArrayClient.start(device_name(properties), pose=pose)
            except ArrayServerError as error:
                raise TouchError(str(error)) from error
        if not bpy.app.background:
            bpy.app.timers.register(_update_status, first_interval=_STATUS_INTERVAL)

    def disconnect(self) -> None:
        """Silence the array and end the server; does nothing if not connected."""
        if self.client is not None:
            self.client.close()
        self.client = self.status = None
        if bpy.app.timers.is_registered(_update_status):
            bpy.app.timers.unregister(_update_status)

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
        """Turn contacts into focal points, once per frame of a live session or a bake.

        Args:
            scene: Holds the array object and the settings.
            contacts: ``solver.contacts(hand)`` of each hand, in meters and world coordinates.
            weights: Perceptual weights of the ghosts of each hand.
            dt: Time since the last frame [s]; None to start anew.
            taken: When the contacts were computed, by `time.monotonic` [s]; None for now.
            send: Whether to send the frame to the array; a bake is not real-time and records it.

        Returns:
            The frame, to be recorded with the bake; None if the scene has no array.

        Raises:
            TouchArrayError: The scene's array object is scaled or sheared.
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
            self._send_to(self.client, scene, frame, array, taken=begin)
        self.show(frame)
        return frame

    def send(self, scene: bpy.types.Scene, frame: TouchFrame) -> None:
        """Send a recorded frame to the array if one is connected, and show it.

        Args:
            scene: Holds the array object and the modulation setting.
            frame: What to send.

        Raises:
            TouchArrayError: The scene's array object is scaled or sheared.
        """
        if self.client is not None:
            self._send_to(self.client, scene, frame, placed_array(scene))
        self.show(frame)

    def _send_to(
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
        """Show a frame in the overlay without sending it; None shows nothing."""
        self.shown = frame

    def rest(self) -> None:
        """Silence the array and reset the state between frames, at the end of a live session."""
        self._pipeline = None
        self.show(None)
        if self.client is not None:
            self.client.silence()

    def read_status(self, *, wait: float = 0.0) -> ArrayStatus | None:
        """The server's latest status; None if not connected.

        Args:
            wait: Wait up to this long for a newer status [s].
        """
        if self.client is not None:
            self.status = self.client.status(wait=wait)
        return self.status


touch = TouchConnection()
"""The connection of this Blender process."""


def _update_status() -> float | None:
    """Request and read the status, and redraw the panels."""
    if touch.client is None:
        return None
    touch.client.hello()
    touch.read_status()
    redraw_views()
    return _STATUS_INTERVAL


@persistent
def _end_with_file(*_: object) -> None:
    touch.disconnect()
    touch.rest()


def register() -> None:
    """Disconnect the array whenever another file is opened."""
    add_handlers((("load_pre", _end_with_file),))


def unregister() -> None:
    """Disconnect the array."""
    _end_with_file()
    remove_handlers((("load_pre", _end_with_file),))
