# SPDX-License-Identifier: GPL-3.0-or-later
"""Making clay from meshes, and its appearance."""
