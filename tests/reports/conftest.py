# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases from the field are tested in the same fresh Blender as the add-on."""

from tactile_clay.tests.clay_addon.conftest import studio

__all__ = ["studio"]
