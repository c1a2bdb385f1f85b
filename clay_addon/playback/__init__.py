# SPDX-License-Identifier: GPL-3.0-or-later
"""Showing baked, packed and keyed clay on the timeline."""
