# SPDX-License-Identifier: GPL-3.0-or-later
"""What a .blend keeps about its clay, and what those properties mean."""
