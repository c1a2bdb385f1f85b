# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a bake, written atomically."""
