# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in the rest pose: anatomy, shape, skin, flesh, and their binding to bones."""
