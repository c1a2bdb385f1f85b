# SPDX-License-Identifier: GPL-3.0-or-later
"""A live session and its parts: the solver, the clay that is shown, touch, take, undo, autosave."""
