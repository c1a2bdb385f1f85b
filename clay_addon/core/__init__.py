# SPDX-License-Identifier: GPL-3.0-or-later
"""All of the add-on that needs no Blender."""
