# SPDX-License-Identifier: GPL-3.0-or-later
"""The second thread that passes of the CPU are shared with."""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache


@cache
def helper_thread() -> ThreadPoolExecutor:
    """The thread that works beside the caller's."""
    return ThreadPoolExecutor(1, thread_name_prefix="clay")


def processor_count() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
