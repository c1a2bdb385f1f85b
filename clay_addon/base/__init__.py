# SPDX-License-Identifier: GPL-3.0-or-later
"""What every room of the add-on uses of Blender: preferences, handlers, meshes, keyframes."""
