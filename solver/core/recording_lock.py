# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps other threads out of Warp while one records.

On a CPU, Warp keeps one capture for the whole process (1.19: ``runtime._apic_capture``). What other
threads launch, allocate or copy meanwhile runs at once and is not replayed, but it is registered
with that capture, which the recording thread frees when it ends. Without the lock that is a use
after free: a few hundred recordings beside a thread that launches small kernels crash the process,
or raise errors about missing attributes in either thread. Replaying during a recording is safe.

So `Recordings` holds the lock while it records, which takes milliseconds, and everything that uses
Warp on a thread other than the solver's holds it too: filling meshes, binding hands, surfaces. A
solver itself steps without it; only one may step at a time.
"""

import threading

recording_lock = threading.RLock()
"""Held while passes are recorded, and while Warp is used beside a solver on another thread."""
