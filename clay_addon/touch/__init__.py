# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch: the array, the connection to its server, and what each frame feels like."""
