# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns contact forces into focal points on an ultrasound array. Never imports Blender."""

from .acoustics.acoustic_field import acoustic_field
from .acoustics.drive import solve_drive
from .acoustics.drive_steps import drive_steps
from .acoustics.transducer_array import TransducerArray
from .array_server import ArrayClient, ArrayStatus
from .foci.focal_points import Foci, focus, reconstruct
from .foci.spatiotemporal import Route, plan_route
from .skin.pressure_field import PressureField
from .skin.sensitivity import SkinSensitivity

__all__ = [
    "ArrayClient",
    "ArrayStatus",
    "Foci",
    "PressureField",
    "Route",
    "SkinSensitivity",
    "TransducerArray",
    "acoustic_field",
    "drive_steps",
    "focus",
    "plan_route",
    "reconstruct",
    "solve_drive",
]
