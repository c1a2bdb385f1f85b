# SPDX-License-Identifier: GPL-3.0-or-later
"""Playing baked, packed and keyed clay on the timeline."""
