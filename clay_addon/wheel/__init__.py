# SPDX-License-Identifier: GPL-3.0-or-later
"""Potter's wheels: their speed and their angle."""
