# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed meshes and their filling, lattices, surface nets and rotations."""
