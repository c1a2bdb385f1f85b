# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands in Blender: making, reading, storing and checking them."""
