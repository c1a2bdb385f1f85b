# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of particles: finding them, the forces between them and their tangent."""
