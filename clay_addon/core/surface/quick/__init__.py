# SPDX-License-Identifier: GPL-3.0-or-later
"""A smooth surface fast enough for live sculpting."""
