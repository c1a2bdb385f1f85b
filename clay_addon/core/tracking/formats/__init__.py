# SPDX-License-Identifier: GPL-3.0-or-later
"""The formats in which trackers describe hands."""
