# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands before they move: anatomy, shape, skin, flesh and their binding to bones."""
