# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender basics shared by the whole add-on: preferences, handlers, meshes, keyframes."""
