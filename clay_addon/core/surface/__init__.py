# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces of particle clay: the exact one, the quick one and their files."""
