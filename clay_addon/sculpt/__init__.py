# SPDX-License-Identifier: GPL-3.0-or-later
"""Live sculpting with tracked hands and the mouse: operators, panel, brush settings, overlay.

The session itself is in `live`.
"""
