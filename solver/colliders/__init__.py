# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes and moving meshes on the device."""
