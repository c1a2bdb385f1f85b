# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracked hands: one datagram format, senders in processes of their own, and what follows a hand.

A sender (`tactile-clay track SOURCE`) turns what its tracker says into datagrams to loopback. In
Blender a receiver keeps the newest frame of each hand, a tracker of presence says whether the hand
is live, held or lost, and retargeting lays its joints on the bones of an armature.

Only ``armature``, ``keyframes``, ``live``, ``operators``, ``panel`` and ``properties`` know
Blender; the senders run without it.
"""

from ....solver.core.errors import TactileClayError

__all__ = ["TrackingError"]


class TrackingError(TactileClayError):
    """Tracking cannot go on; the message says why and what to do."""
