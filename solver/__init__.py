# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay, contact and what moves them: Warp and numpy, never Blender.

What needs Warp is loaded on first use, so that materials and mesh checks cost nothing to import.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .closed_mesh import MeshError, check_closed_mesh
from .material import Material
from .settings import QUALITIES, Settings

if TYPE_CHECKING:
    from .default_hand import default_hand_rig
    from .diagnostics import Diagnostics
    from .fill import fill_mesh
    from .hand import Hand, HandContacts
    from .hand_binding import bind_hand
    from .hand_rig import HandRig
    from .scene import ClayBody, MeshCollider, Plane, Scene
    from .skinned_hand import SkinnedHand
    from .solver import Solver

__all__ = [
    "QUALITIES",
    "ClayBody",
    "Diagnostics",
    "Hand",
    "HandContacts",
    "HandRig",
    "Material",
    "MeshCollider",
    "MeshError",
    "Plane",
    "Scene",
    "Settings",
    "SkinnedHand",
    "Solver",
    "bind_hand",
    "check_closed_mesh",
    "default_hand_rig",
    "fill_mesh",
]

_LOADED_ON_USE = {
    "ClayBody": "scene",
    "Diagnostics": "diagnostics",
    "Hand": "hand",
    "HandContacts": "hand",
    "HandRig": "hand_rig",
    "MeshCollider": "scene",
    "Plane": "scene",
    "Scene": "scene",
    "SkinnedHand": "skinned_hand",
    "Solver": "solver",
    "bind_hand": "hand_binding",
    "default_hand_rig": "default_hand",
    "fill_mesh": "fill",
}


def __getattr__(name: str) -> Any:
    if name in _LOADED_ON_USE:
        return getattr(import_module(f".{_LOADED_ON_USE[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
