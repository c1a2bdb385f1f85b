# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs in a real Blender's window: a person's steps, each waiting for what it needs to have come.

A script is a generator: it yields seconds, or a function that says whether it may go on. A redraw
takes most of a second without a graphics card, so steps wait for what happens and not for time.
"""

import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Generator
from typing import Any

import bpy

PATIENCE = 240.0
"""What has not happened by then [s] will not happen; the first start compiles kernels."""

Step = float | Callable[[], object]
_mouse = [0, 0]


def view() -> tuple[Any, Any, Any]:
    """The first window, its 3D view and the region that shows the scene."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    return window, area, next(region for region in area.regions if region.type == "WINDOW")


def in_view() -> Any:
    """Do what is done inside as if the mouse were over the 3D view."""
    window, area, region = view()
    return bpy.context.temp_override(window=window, area=area, region=region)


def on_screen(place: Any) -> tuple[int, int]:
    """Where a point of the scene is seen in the window [pixels]."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    _, area, region = view()
    found = location_3d_to_region_2d(region, area.spaces.active.region_3d, place)
    assert found is not None, place
    return round(region.x + found.x), round(region.y + found.y)


def event(kind: str, value: str = "PRESS", **more: Any) -> None:
    """Let something happen at the mouse or the keyboard."""
    window, _, _ = view()
    window.event_simulate(type=kind, value=value, x=_mouse[0], y=_mouse[1], **more)


def key(kind: str, **more: Any) -> None:
    """Press a key and let it go."""
    event(kind, **more)
    event(kind, "RELEASE", **more)


def move(place: tuple[int, int]) -> None:
    """Move the mouse [pixels]."""
    _mouse[:] = place
    event("MOUSEMOVE", "NOTHING")


def screenshot(path: str) -> None:
    """What is seen on the screen, as a picture: Blender's own comes out black."""
    with in_view():
        bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)
    subprocess.run(["import", "-window", "root", path], check=False)


def run(steps: Generator[Step, None, None]) -> None:
    """Go through the steps, then end Blender with 0; with 9 after an error."""
    state: dict[str, Any] = {"wait": None, "until": 0.0}
    bpy.context.preferences.use_preferences_save = False
    bpy.context.preferences.view.show_splash = False

    def go_on() -> float | None:
        try:
            wait = state["wait"]
            if wait is not None and not wait():
                if time.monotonic() > state["until"]:
                    frame = getattr(steps, "gi_frame", None)
                    raise TimeoutError(f"waited in vain at line {getattr(frame, 'f_lineno', '?')}")
                return 0.02
            state["wait"] = None
            step = next(steps)
            if callable(step):
                state["wait"], state["until"] = step, time.monotonic() + PATIENCE
                return 0.02
            return float(step)
        except StopIteration:
            print("STEPS DONE", flush=True)
            sys.stdout.flush()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(9)

    # Also after another file is opened.
    bpy.app.timers.register(go_on, first_interval=0.5, persistent=True)
