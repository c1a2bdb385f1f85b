# SPDX-License-Identifier: GPL-3.0-or-later
"""Tactile Clay: model clay in Blender with tracked hands, feel it, bake it, export it.

This file is what Blender's extension format asks for and nothing else. The parts are
``solver`` and ``haptics`` (never Blender), and ``clay_addon`` (all that is Blender).
"""


def register() -> None:
    """Register the add-on with Blender."""
    from . import clay_addon

    clay_addon.register()


def unregister() -> None:
    """Remove everything that `register` added."""
    from . import clay_addon

    clay_addon.unregister()
