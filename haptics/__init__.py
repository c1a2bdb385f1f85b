# SPDX-License-Identifier: GPL-3.0-or-later
"""From contact forces to focal points on an ultrasound array. Never imports Blender."""

__all__: list[str] = []
