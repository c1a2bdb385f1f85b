# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake: simulating a scene frame by frame into its cache."""
