# SPDX-License-Identifier: GPL-3.0-or-later
"""From contact forces to focal points on an ultrasound array. Never imports Blender."""

from .acoustic_field import acoustic_field
from .array_server import ArrayClient, ArrayStatus
from .drive import solve_drive
from .transducer_array import TransducerArray

__all__ = ["ArrayClient", "ArrayStatus", "TransducerArray", "acoustic_field", "solve_drive"]
