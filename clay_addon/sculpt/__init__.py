# SPDX-License-Identifier: GPL-3.0-or-later
"""Sculpting live: a session in which clay moves under tracked hands and the mouse."""
