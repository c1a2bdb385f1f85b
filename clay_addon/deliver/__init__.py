# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaving Blender: USD and Alembic, meshes for printing, rendered frames."""
