# SPDX-License-Identifier: GPL-3.0-or-later
"""Particles on the device, which of them are awake, and how passes over them are run."""
