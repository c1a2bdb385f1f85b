# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracked hands in Blender: armatures that follow a tracker."""
