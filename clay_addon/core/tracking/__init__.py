# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand tracking: one datagram format, a separate sender process per tracker, and retargeting.

A sender (`tactile-clay track SOURCE`) converts its tracker's data to datagrams and sends them to
loopback. In Blender a receiver collects the new frames of each hand, `Presence` decides whether
the hand is live, held or lost, and retargeting poses the bones of an armature.

Nothing here imports Blender; the Blender side is in ``clay_addon/tracking``.
"""

from ....solver.core.errors import TactileClayError

__all__ = ["TrackingError"]


class TrackingError(TactileClayError):
    """Tracking cannot continue; the message says why and what to do."""
