# SPDX-License-Identifier: GPL-3.0-or-later
"""Senders, one a tracker, each a process of its own."""
