# SPDX-License-Identifier: GPL-3.0-or-later
"""The class that all errors of the project have in common."""


class TactileClayError(Exception):
    """Something cannot be done; the message says what is wrong and what to do, for a person."""
