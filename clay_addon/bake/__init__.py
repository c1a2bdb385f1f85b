# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking: simulating a scene frame by frame into its cache."""
