# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces of particle clay, exact or quick, and 3MF files."""
