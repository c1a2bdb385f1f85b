# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes, moving meshes and hands on the device, and the clay's contacts with them."""
