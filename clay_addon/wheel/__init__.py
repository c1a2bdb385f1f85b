# SPDX-License-Identifier: GPL-3.0-or-later
"""Potter's wheels: their speed, and how far they have turned."""
