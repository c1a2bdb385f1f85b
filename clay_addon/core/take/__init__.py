# SPDX-License-Identifier: GPL-3.0-or-later
"""A take as data, and its files."""
