# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay, contact and what moves them: Warp and numpy, never Blender.

What needs Warp is loaded on first use, so that materials and mesh checks cost nothing to import.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .geometry.closed_mesh import MeshError, check_closed_mesh
from .scene.material import Material
from .scene.settings import QUALITIES, Settings

if TYPE_CHECKING:
    from .geometry.fill import fill_mesh
    from .hand.binding import bind_hand
    from .hand.default_hand import default_hand_rig
    from .hand.rig import HandRig
    from .hand.skinned_hand import SkinnedHand
    from .scene.diagnostics import Diagnostics
    from .scene.hand import Hand, HandContacts
    from .scene.scene import ClayBody, MeshCollider, Plane, Scene
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
    "ClayBody": "scene.scene",
    "Diagnostics": "scene.diagnostics",
    "Hand": "scene.hand",
    "HandContacts": "scene.hand",
    "HandRig": "hand.rig",
    "MeshCollider": "scene.scene",
    "Plane": "scene.scene",
    "Scene": "scene.scene",
    "SkinnedHand": "hand.skinned_hand",
    "Solver": "solver",
    "bind_hand": "hand.binding",
    "default_hand_rig": "hand.default_hand",
    "fill_mesh": "geometry.fill",
}


def __getattr__(name: str) -> Any:
    if name in _LOADED_ON_USE:
        return getattr(import_module(f".{_LOADED_ON_USE[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
