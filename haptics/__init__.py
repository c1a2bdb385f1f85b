# SPDX-License-Identifier: GPL-3.0-or-later
"""From contact forces to focal points on an ultrasound array. Never imports Blender."""

from .acoustic_field import acoustic_field
from .array_server import ArrayClient, ArrayStatus
from .drive import solve_drive
from .drive_steps import drive_steps
from .focal_points import Foci, focus, reconstruct
from .pressure_field import PressureField
from .skin_sensitivity import SkinSensitivity
from .spatiotemporal import Route, plan_route
from .transducer_array import TransducerArray

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
