# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording live sessions, keying them on the timeline, and baking them again."""
