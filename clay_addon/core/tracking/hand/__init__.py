# SPDX-License-Identifier: GPL-3.0-or-later
"""What follows a tracked hand: filters, presence, measuring and retargeting."""
