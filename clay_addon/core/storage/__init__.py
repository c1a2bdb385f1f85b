# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake on disk, written whole or not at all."""
