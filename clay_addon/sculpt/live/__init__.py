# SPDX-License-Identifier: GPL-3.0-or-later
"""A live session and its parts: solver, displayed clay, touch, take, undo and autosave."""
