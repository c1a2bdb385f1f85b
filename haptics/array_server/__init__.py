# SPDX-License-Identifier: GPL-3.0-or-later
"""A separate process that drives an array safely with focal points, and its client."""

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
