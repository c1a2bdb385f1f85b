# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool in the mouse: from cursor movements to poses of tools and edits."""
