# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact and friction of clay with planes, meshes and hands."""
