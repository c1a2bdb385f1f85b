# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of contact and friction, and the search for contacts."""
