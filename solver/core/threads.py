# SPDX-License-Identifier: GPL-3.0-or-later
"""The threads of the solver.

- The calling thread owns the scene and the solver: it adds, steps and reads. Any thread may call,
  one at a time; the add-on's live session has a worker for it.
- ``clay``, the helper thread, processes the second half of the particles in passes that can be
  shared, while the caller processes the first half and waits for it. It owns nothing. There is one
  per process, started by the first step that shares work; between steps it is idle, and it ends
  with the interpreter. Within recorded passes the two wait for each other in native code
  (`particles_cpu.wait_for_others`).

Other threads that use Warp during a step hold `recording_lock`.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache


@cache
def helper_thread() -> ThreadPoolExecutor:
    """The thread that works beside the caller's, started on first use."""
    return ThreadPoolExecutor(1, thread_name_prefix="clay")


def processor_count() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
