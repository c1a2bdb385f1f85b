# SPDX-License-Identifier: GPL-3.0-or-later
"""Pressure on the skin, and how much each part of a hand feels of it."""
