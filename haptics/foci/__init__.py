# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns pressure on the skin into focal points, or into routes along which they move."""
