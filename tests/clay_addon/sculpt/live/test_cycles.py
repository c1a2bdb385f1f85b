# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting and ending many sessions."""

import gc
import resource
import threading
from pathlib import Path
from typing import Any

import bpy

from tactile_clay.clay_addon.sculpt.live.current import current


def handler_count() -> int:
    """Number of registered application handlers."""
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    return sum(len(found) for found in lists if isinstance(found, list))


def test_three_hundred_sessions_leave_nothing_behind(studio: Any, tmp_path: Path) -> None:
    """Leave memory, threads, handlers and data-blocks unchanged."""
    studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    studio.save(tmp_path)

    def cycle() -> None:
        running = current.start(bpy.context)
        for _ in range(3):
            running.wait()
            running.tick(bpy.context)
        current.stop(bpy.context)

    def held() -> tuple[int, int, list[int]]:
        gc.collect()
        blocks = [bpy.data.objects, bpy.data.meshes, bpy.data.pointclouds, bpy.data.materials]
        return threading.active_count(), handler_count(), [len(found) for found in blocks]

    def peak() -> float:
        return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for _ in range(40):
        cycle()
    before, memory = held(), peak()
    for _ in range(260):
        cycle()
    grown = peak() - memory
    assert held() == before
    # A session of this clay takes about ten megabytes: leaking one in fifty would show.
    assert grown < 60e6, f"{grown / 1e6:.0f} MB in 260 sessions"
