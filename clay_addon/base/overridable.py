# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties that library overrides keep."""

from __future__ import annotations

from typing import TypeVar

import bpy

Group = TypeVar("Group", bound=type[bpy.types.PropertyGroup])


def overridable(group: Group) -> Group:
    """Let library overrides keep what is set in a group of properties: a class decorator.

    Blender forgets all other properties of an override when the file is opened again.
    """
    for base in group.__mro__:
        for declared in getattr(base, "__annotations__", {}).values():
            if hasattr(declared, "keywords"):
                declared.keywords["override"] = {"LIBRARY_OVERRIDABLE"}
    return group
