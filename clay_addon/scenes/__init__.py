# SPDX-License-Identifier: GPL-3.0-or-later
"""Ready-made clay and whole scenes, ready to play."""
