# SPDX-License-Identifier: GPL-3.0-or-later
"""The input queue of a brush: events of Blender's window wait here until the next tick.

It also decides which events the brush consumes, so that Blender does not handle them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..tools.settings import BrushSettings
from .adjust import MIN_RADIUS, Adjusted, Adjustment
from .view_region import Pointer, find_pointer, pointer_in

_MOVES = ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE")
_MIN_PRESSURE = 0.05
"""Lower bound on pen pressure, as a pen initially reports none."""
_STEP = 1.1
"""Factor by which [ and ] change the radius."""
_MAX_SAMPLES = 6
"""Maximum number of mouse motions used per step."""


class Source(Protocol):
    """Stores the settings of a brush; see `SceneSource`."""

    def read(self) -> BrushSettings:
        """The current settings."""

    def write(self, name: Adjusted, value: float) -> None:
        """Set the radius [m] or the strength."""


@dataclass(frozen=True)
class Sample:
    """The mouse or pen at one moment of a stroke."""

    pointer: Pointer
    """Its position in the view."""
    pressure: float
    """Pen pressure, 0 to 1; 1 for a mouse."""
    shift: bool
    """Whether Shift is held."""
    ctrl: bool
    """Whether Ctrl is held."""


class BrushInput:
    """Collects input from mouse, pen, wheel and keys until the next tick.

    Args:
        source: Receives an adjusted radius or strength.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._samples: list[Sample] = []
        self._wheel = 0.0
        self._press: Sample | None = None
        self._held = self._canceled = False
        self._adjustment: Adjustment | None = None
        self._pointer: Pointer | None = None

    @property
    def pointer(self) -> Pointer | None:
        """The mouse in a 3D view; None outside the 3D views."""
        return self._pointer

    @property
    def adjustment(self) -> Adjustment | None:
        """The ongoing adjustment of radius or strength, if any."""
        return self._adjustment

    @property
    def held(self) -> bool:
        """Whether the button of a stroke is down."""
        return self._held

    @property
    def stroking(self) -> bool:
        """Whether the button of a stroke is down, or its press is still in the queue."""
        return self._held or self._press is not None

    def take_press(self) -> Sample | None:
        """The queued press that starts a stroke, if any; removes it from the queue."""
        press, self._press = self._press, None
        return press

    def take_cancel(self) -> bool:
        """Whether the user has canceled the stroke since the last call."""
        canceled, self._canceled = self._canceled, False
        return canceled

    def take_samples(self) -> list[Sample]:
        """Motions since the last call, evenly thinned out, always including the last one."""
        samples, self._samples = self._samples, []
        step = -(-len(samples) // _MAX_SAMPLES) if samples else 1
        return samples[::-1][::step][::-1]

    def take_wheel(self) -> float:
        """Steps of the wheel since the last call; positive is deeper."""
        steps, self._wheel = self._wheel, 0.0
        return steps

    def release(self) -> None:
        """Treat the button as released, because a stroke cannot begin."""
        self._held = False

    def cancel(self) -> None:
        """Drop everything in the queue, and restore a value that is being adjusted."""
        if self._adjustment is not None:
            self._source.write(self._adjustment.name, self._adjustment.start)
        self._adjustment = self._press = None
        self._held = self._canceled = False
        self._samples.clear()
        self._wheel = 0.0

    def handle(
        self,
        context: Any,
        event: Any,
        settings: BrushSettings,
        world_point: Callable[[Pointer], NDArray[np.float64]],
    ) -> bool:
        """Handle an event of Blender's window.

        Args:
            context: The context of the event's window.
            event: The event.
            settings: Current settings of the brush.
            world_point: Returns the world position of a pointer [m], shape [3].

        Returns:
            Whether the brush has consumed the event.
        """
        if self._adjustment is not None:
            return self._adjust(event)
        if self._held:
            return self._steer(context, event, settings)
        self._pointer = pointer = find_pointer(context, event.mouse_x, event.mouse_y)
        if pointer is None or event.type in _MOVES or event.value != "PRESS":
            return False
        if settings.tool.identifier == "NONE":
            return False
        if event.type == "LEFTMOUSE":
            return self._begin(pointer, event, settings)
        return self._key(event, pointer, settings, world_point)

    def status_text(self, settings: BrushSettings) -> str:
        """What keys and buttons currently do, for the status bar."""
        tool = settings.tool
        if self.adjustment is not None:
            return "Left mouse: confirm   Right mouse: cancel   Shift: precise"
        if self.held and tool.path == "pinch":
            return "Wheel or Shift: pull away from the surface   Esc: release"
        if self.held and tool.path not in ("edit", "view"):
            return "Wheel: change depth   Esc: release"
        parts = []
        if tool.identifier != "NONE":
            parts.append(f"Left mouse: {tool.label}")
            if tool.edit in ("add", "remove"):
                parts.append("Ctrl: " + ("remove" if tool.edit == "add" else "add"))
            parts += ["F, [ ]: radius", "Shift F: strength"]
        return "   ".join((*parts, "Shift Space: tools", "Esc: finish"))

    def _begin(self, pointer: Pointer, event: Any, settings: BrushSettings) -> bool:
        inverts = event.ctrl and settings.tool.edit in ("add", "remove")
        if event.alt or event.shift or event.oskey or (event.ctrl and not inverts):
            return False
        self.cancel()
        self._press = _sample(pointer, event, settings)
        self._held = True
        return True

    def _steer(self, context: Any, event: Any, settings: BrushSettings) -> bool:
        """Handle an event during a stroke; the brush then consumes all events."""
        if event.type in _MOVES:
            assert self._pointer is not None
            area, region = self._pointer.area, self._pointer.region
            self._pointer = pointer_in(context, area, region, event.mouse_x, event.mouse_y)
            self._samples.append(_sample(self._pointer, event, settings))
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self._held = False
        elif event.type == "WINDOW_DEACTIVATE":
            # Another window may get the release event.
            self._held = False
        elif event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self._canceled = True
        elif event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE"):
            self._wheel += 1.0 if event.type == "WHEELDOWNMOUSE" else -1.0
        return True

    def _key(
        self,
        event: Any,
        pointer: Pointer,
        settings: BrushSettings,
        world_point: Callable[[Pointer], NDArray[np.float64]],
    ) -> bool:
        if event.ctrl or event.alt or event.oskey:
            return False
        if event.type == "F":
            name: Adjusted = "strength" if event.shift else "radius"
            pixel = pointer.view.pixel(world_point(pointer))
            self._adjustment = Adjustment(name, getattr(settings, name), pixel, event.mouse_x)
            self._update_header()
            return True
        if event.type in ("LEFT_BRACKET", "RIGHT_BRACKET") and not event.shift:
            factor = _STEP if event.type == "RIGHT_BRACKET" else 1.0 / _STEP
            self._source.write("radius", max(settings.radius * factor, MIN_RADIUS))
            return True
        return False

    def _adjust(self, event: Any) -> bool:
        adjustment = self._adjustment
        assert adjustment is not None
        if event.type in _MOVES:
            value = adjustment.move(event.mouse_x, precise=bool(event.shift))
            self._source.write(adjustment.name, value)
        elif event.value == "PRESS" and event.type in ("LEFTMOUSE", "RET", "NUMPAD_ENTER", "SPACE"):
            self._adjustment = None
        elif event.value == "PRESS" and event.type in ("RIGHTMOUSE", "ESC"):
            self.cancel()
        self._update_header()
        return True

    def _update_header(self) -> None:
        """Show the adjusted value in the header of the view."""
        assert self._pointer is not None
        text = None if self._adjustment is None else self._adjustment.text
        self._pointer.area.header_text_set(text)
        self._pointer.area.tag_redraw()


def _sample(pointer: Pointer, event: Any, settings: BrushSettings) -> Sample:
    pressure = 1.0
    if settings.use_pressure and event.is_tablet:
        pressure = float(min(max(event.pressure, _MIN_PRESSURE), 1.0))
    return Sample(pointer, pressure, bool(event.shift), bool(event.ctrl))
