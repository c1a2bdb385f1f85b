# SPDX-License-Identifier: GPL-3.0-or-later
"""Output of the clay: USD and Alembic, meshes for printing, rendered frames."""
