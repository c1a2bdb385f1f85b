# SPDX-License-Identifier: GPL-3.0-or-later
"""Pressure on the skin, and how sensitive each part of a hand is to it."""
