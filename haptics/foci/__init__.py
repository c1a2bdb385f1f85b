# SPDX-License-Identifier: GPL-3.0-or-later
"""From pressure on the skin to focal points and routes of them."""
