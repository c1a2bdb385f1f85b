# SPDX-License-Identifier: GPL-3.0-or-later
"""Ready-made clay objects and complete scenes."""
