# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps other threads out of Warp while one records.

On a CPU, Warp keeps one capture for the whole process (1.19: ``runtime._apic_capture``). What other
threads launch, allocate or copy meanwhile runs at once and is not replayed, but it is registered
with that capture, which the recording thread frees when it ends. Without the lock that is a use
after free: a few hundred recordings beside a thread that launches small kernels crash the process,
or raise errors about missing attributes in either thread. Replaying during a recording is safe.

So `Recordings` holds the lock while it records, which takes milliseconds, and everything that uses
Warp on a thread other than the solver's holds it too: filling meshes, binding hands, surfaces. A
solver itself steps without it, so that surfaces are made meanwhile.

Two solvers may be alive at once: a session that was ended is still finishing its step on its own
thread when the next one, or a bake, begins. So each solver holds `solver_lock` while it is made,
steps or is restored.
"""

import functools
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Returned = TypeVar("Returned")

recording_lock = threading.RLock()
"""Held while passes are recorded, and while Warp is used beside a solver on another thread."""

solver_lock = threading.RLock()
"""Held by a solver while it uses Warp: a solver on another thread may be recording."""


def alone(method: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Let a method of a solver run while no other solver's does: a decorator."""

    @functools.wraps(method)
    def held(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        with solver_lock:
            return method(*args, **kwargs)

    return held
