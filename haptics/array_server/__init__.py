# SPDX-License-Identifier: GPL-3.0-or-later
"""From focal points to an array that is always safe: a process of its own, and its client."""

from ..protocol.datagram import Modulation
from .client import DEFAULT_PORT, ArrayClient, ArrayServerError, ArrayStatus
from .limits import Limits

__all__ = [
    "DEFAULT_PORT",
    "ArrayClient",
    "ArrayServerError",
    "ArrayStatus",
    "Limits",
    "Modulation",
]
