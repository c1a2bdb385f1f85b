# SPDX-License-Identifier: GPL-3.0-or-later
"""The input queue of a brush: events of Blender's window wait here until the next tick.

It also decides which events are the brush's own, so that Blender does not see them.
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
"""A pen reports no pressure at first."""
_STEP = 1.1
"""A press of [ or ] changes the radius by this factor."""
_MAX_SAMPLES = 6
"""At most this many of the motions between two steps are used."""


class Source(Protocol):
    """Where the settings of a brush are kept; see `SceneSource`."""

    def read(self) -> BrushSettings:
        """What is set now."""

    def write(self, name: Adjusted, value: float) -> None:
        """Set the radius [m] or the strength."""


@dataclass(frozen=True)
class Sample:
    """The mouse or pen at one moment of a stroke."""

    pointer: Pointer
    """Where it is."""
    pressure: float
    """0 to 1; 1 for a mouse."""
    shift: bool
    """Whether Shift is held."""
    ctrl: bool
    """Whether Ctrl is held."""


class BrushInput:
    """Gathers what the user does with mouse, pen, wheel and keys, and hands it out at the tick.

    Args:
        source: Where a radius or strength that is being chosen is written.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._samples: list[Sample] = []
        self._wheel = 0.0
        self._press: Sample | None = None
        self._held = self._cancelled = False
        self._adjustment: Adjustment | None = None
        self._pointer: Pointer | None = None

    @property
    def pointer(self) -> Pointer | None:
        """Where the mouse is; None outside the 3D views."""
        return self._pointer

    @property
    def adjustment(self) -> Adjustment | None:
        """The radius or strength that is being chosen."""
        return self._adjustment

    @property
    def held(self) -> bool:
        """Whether the button of a stroke is down."""
        return self._held

    @property
    def stroking(self) -> bool:
        """Whether the button of a stroke is down, or was pressed and no stroke has begun yet."""
        return self._held or self._press is not None

    def take_press(self) -> Sample | None:
        """The press that a stroke should begin with, once."""
        press, self._press = self._press, None
        return press

    def take_cancel(self) -> bool:
        """Whether the user has cancelled the stroke since the last call."""
        cancelled, self._cancelled = self._cancelled, False
        return cancelled

    def take_samples(self) -> list[Sample]:
        """Motions since the last call, thinned out evenly; the last one is always among them."""
        samples, self._samples = self._samples, []
        step = -(-len(samples) // _MAX_SAMPLES) if samples else 1
        return samples[::-1][::step][::-1]

    def take_wheel(self) -> float:
        """Steps of the wheel since the last call; positive is deeper."""
        steps, self._wheel = self._wheel, 0.0
        return steps

    def release(self) -> None:
        """Treat the button as released, where a stroke cannot begin."""
        self._held = False

    def cancel(self) -> None:
        """Drop everything that waits; a value that is being chosen returns to what it was."""
        if self._adjustment is not None:
            self._source.write(self._adjustment.name, self._adjustment.start)
        self._adjustment = self._press = None
        self._held = self._cancelled = False
        self._samples.clear()
        self._wheel = 0.0

    def handle(
        self,
        context: Any,
        event: Any,
        settings: BrushSettings,
        place: Callable[[Pointer], NDArray[np.float64]],
    ) -> bool:
        """Take an event of Blender's window.

        Args:
            context: Its window is the event's.
            event: The event.
            settings: What the brush is set to now.
            place: Where a pointer is in the world [m], shape [3].

        Returns:
            Whether the event was for the brush.
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
        return self._key(event, pointer, settings, place)

    def status_text(self, settings: BrushSettings) -> str:
        """What keys and buttons do now, for the status bar."""
        tool = settings.tool
        if self.adjustment is not None:
            return "Left mouse: confirm   Right mouse: cancel   Shift: precise"
        if self.held and tool.path == "pinch":
            return "Wheel or Shift: pull away from the surface   Esc: let go"
        if self.held and tool.path not in ("edit", "view"):
            return "Wheel: deeper or less deep   Esc: let go"
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
        """Follow the mouse during a stroke; all events are then the brush's."""
        if event.type in _MOVES:
            assert self._pointer is not None
            area, region = self._pointer.area, self._pointer.region
            self._pointer = pointer_in(context, area, region, event.mouse_x, event.mouse_y)
            self._samples.append(_sample(self._pointer, event, settings))
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self._held = False
        elif event.type == "WINDOW_DEACTIVATE":
            # The release may go to another window.
            self._held = False
        elif event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self._cancelled = True
        elif event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE"):
            self._wheel += 1.0 if event.type == "WHEELDOWNMOUSE" else -1.0
        return True

    def _key(
        self,
        event: Any,
        pointer: Pointer,
        settings: BrushSettings,
        place: Callable[[Pointer], NDArray[np.float64]],
    ) -> bool:
        if event.ctrl or event.alt or event.oskey:
            return False
        if event.type == "F":
            name: Adjusted = "strength" if event.shift else "radius"
            pixel = pointer.view.pixel(place(pointer))
            self._adjustment = Adjustment(name, getattr(settings, name), pixel, event.mouse_x)
            self._tell()
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
        self._tell()
        return True

    def _tell(self) -> None:
        """Show the value that is being chosen in the header of the view."""
        assert self._pointer is not None
        text = None if self._adjustment is None else self._adjustment.text
        self._pointer.area.header_text_set(text)
        self._pointer.area.tag_redraw()


def _sample(pointer: Pointer, event: Any, settings: BrushSettings) -> Sample:
    pressure = 1.0
    if settings.use_pressure and event.is_tablet:
        pressure = float(min(max(event.pressure, _MIN_PRESSURE), 1.0))
    return Sample(pointer, pressure, bool(event.shift), bool(event.ctrl))
