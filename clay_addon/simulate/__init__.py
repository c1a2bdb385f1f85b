# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of a Blender scene to a solver."""
