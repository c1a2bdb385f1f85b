# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulation of clay, hands and colliders with Warp and NumPy, independent of Blender.

Modules that need Warp are loaded on first use, so importing materials and mesh checks is fast.
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

# A test compares this table with __all__.
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
    """Load a public name from its module on first use."""
    if name in _LOADED_ON_USE:
        return getattr(import_module(f".{_LOADED_ON_USE[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
