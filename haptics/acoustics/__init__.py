# SPDX-License-Identifier: GPL-3.0-or-later
"""Transducer arrays, the sound field they make, and what drives them."""
