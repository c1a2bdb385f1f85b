# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch: the array object, the connection to its server, and focal points of each frame."""
