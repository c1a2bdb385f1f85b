# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's thread in a live session, and the session's pace."""
