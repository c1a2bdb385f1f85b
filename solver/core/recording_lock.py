# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps threads apart while one records.

On a CPU, Warp records whatever any thread launches or allocates while passes are recorded. So that
holds the lock, and whoever may use Warp beside a solver that steps on another thread holds it too.
"""

import threading

recording_lock = threading.RLock()
"""Held while passes are recorded, and while kernels run beside a solver."""
