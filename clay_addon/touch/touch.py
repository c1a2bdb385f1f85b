# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch: the connection to an array server, and what each frame is felt.

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
    from ...haptics.array_server import ArrayClient, ArrayStatus
    from ...haptics.foci.pipeline import TouchFrame, TouchPipeline

_LOOK_EVERY = 0.25
"""The status is asked for this often [s]."""
_ANSWERS_WITHIN = 2.0
"""A server that was started by hand answers at once [s]."""
_PARTS = {"SONICSURFACE": "pyserial", "ULTRAINO": "pyserial", "OPENMPD": "pyusb", "AUTD3": "autd3"}
_MODULES = {"pyserial": "serial", "pyusb": "usb", "autd3": "autd3"}

client: ArrayClient | None = None
"""The connection; None while there is none."""
shown: TouchFrame | None = None
"""What is felt now, or would be if an array were connected."""
status: ArrayStatus | None = None
"""What the server said last."""
_pipeline: TouchPipeline | None = None


class TouchError(TactileClayError):
    """Touch cannot be had; the message says why and what to do."""


def missing_touch_part(kind: str) -> str:
    """What a kind of device needs that is not installed, as a sentence; mostly empty."""
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


def connect(context: bpy.types.Context) -> None:
    """Start an array server for the scene's device, or connect to one that runs.

    Raises:
        TouchError: It does not start.
        TouchArrayError: The scene's array object is scaled.
    """
    global client
    disconnect()
    from ...haptics.array_server import ArrayClient, ArrayServerError

    properties = context.scene.tactile_touch
    missing = missing_touch_part(properties.kind)
    if missing:
        raise TouchError(missing)
    array = placed_array(context.scene)
    pose = None if array is None else array.pose
    if properties.kind == "SERVER":
        client = ArrayClient(properties.server_port, pose=pose)
        client.hello()
        found = read_status(wait=_ANSWERS_WITHIN)
        if found is None or not found.heard:
            disconnect()
            raise TouchError(
                f"No array server answers at port {properties.server_port}. Start one with "
                "tactile-clay array-server DEVICE."
            )
    else:
        try:
            client = ArrayClient.start(device_name(properties), pose=pose)
        except ArrayServerError as error:
            raise TouchError(str(error)) from error
    if not bpy.app.background:
        bpy.app.timers.register(_look, first_interval=_LOOK_EVERY)


def disconnect() -> None:
    """Silence the array and end the server; does nothing where there is none."""
    global client, status
    if client is not None:
        client.close()
    client = status = None
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)


def touch_frame(
    scene: bpy.types.Scene,
    contacts: Sequence[Any],
    *,
    weights: Sequence[ArrayLike | None] = (),
    dt: float | None = None,
    taken: float | None = None,
    send: bool = True,
) -> TouchFrame | None:
    """Let a frame be felt: the one thing that a live session or a bake calls, once a frame.

    Args:
        scene: Its array and settings count.
        contacts: ``solver.contacts(hand)`` of each hand, in metres and world coordinates.
        weights: Perceptual weights of each hand's ghosts.
        dt: Time since the last frame [s]; None after a jump.
        taken: When the contacts were taken, by `time.monotonic` [s]; now if not given.
        send: Whether it is sent to the array; a bake is not in time, and only keeps it.

    Returns:
        The frame, to be recorded with the bake; None where the scene has no array.

    Raises:
        TouchArrayError: The scene's array object is scaled.
    """
    global _pipeline
    begin = time.monotonic() if taken is None else taken
    array = placed_array(scene)
    if array is None:
        show(None)
        return None
    if _pipeline is None:
        from ...haptics.foci.pipeline import TouchPipeline

        _pipeline = TouchPipeline()
    properties = scene.tactile_touch
    frame = _pipeline.step(
        contacts,
        array,
        weights=weights if properties.use_weights else (),
        dt=dt,
        gain=properties.gain,
        ceiling=properties.ceiling,
        count=properties.focus_count,
    )
    if send:
        feel(scene, frame, taken=begin)
    else:
        show(frame)
    return frame


def feel(scene: bpy.types.Scene, frame: TouchFrame, *, taken: float | None = None) -> None:
    """Send a frame to the array, if one is connected, and show it.

    Args:
        scene: Its array and modulation count.
        frame: What shall be felt.
        taken: When its contacts were taken, by `time.monotonic` [s]; now if not given.
    """
    if client is not None:
        from ...haptics.array_server import Modulation

        array = placed_array(scene)
        if array is not None:
            client.set_pose(array.pose)
        modulation = Modulation[scene.tactile_touch.modulation]
        client.send(frame, modulation=modulation, time=taken)
        read_status()
    show(frame)


def show(frame: TouchFrame | None) -> None:
    """Show a frame in the overlay without sending it."""
    global shown
    shown = frame


def rest() -> None:
    """Feel nothing, and forget what the last frame was: at the end of a live session."""
    global _pipeline
    _pipeline = None
    show(None)
    if client is not None:
        client.silence()


def read_status(*, wait: float = 0.0) -> ArrayStatus | None:
    """What the server says; None where none is connected.

    Args:
        wait: Wait up to this long [s] for something newer.
    """
    global status
    if client is not None:
        status = client.status(wait=wait)
    return status


def _look() -> float | None:
    """Ask for the status, and have the panels drawn anew."""
    if client is None:
        return None
    client.hello()
    read_status()
    redraw_views()
    return _LOOK_EVERY


@persistent
def _end_with_file(*_: object) -> None:
    disconnect()
    rest()


def register() -> None:
    """Let go of the array when another file is opened."""
    add_handlers((("load_pre", _end_with_file),))


def unregister() -> None:
    """Let go of the array."""
    _end_with_file()
    remove_handlers((("load_pre", _end_with_file),))
