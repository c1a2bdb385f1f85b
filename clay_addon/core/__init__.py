# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of the add-on that do not need Blender."""
