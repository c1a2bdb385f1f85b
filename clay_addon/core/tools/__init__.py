# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools one sculpts with: their meshes, settings and edits."""
