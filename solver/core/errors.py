# SPDX-License-Identifier: GPL-3.0-or-later
"""The base class of the project's errors."""


class TactileClayError(Exception):
    """Something cannot be done; the message tells the user what is wrong and what to do."""
