# SPDX-License-Identifier: GPL-3.0-or-later
"""Sculpting clay live: the session, its mouse and tablet tools, and what is drawn meanwhile."""
