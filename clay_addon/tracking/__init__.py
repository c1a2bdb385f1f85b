# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand tracking in Blender: armatures that follow a tracker."""
