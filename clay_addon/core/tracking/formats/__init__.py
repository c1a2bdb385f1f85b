# SPDX-License-Identifier: GPL-3.0-or-later
"""Parsers for the data formats of the trackers."""
