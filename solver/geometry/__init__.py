# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed meshes, what fills them, lattices, surface nets and rotations."""
