# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands in Blender: creating, binding, storing and checking them."""
