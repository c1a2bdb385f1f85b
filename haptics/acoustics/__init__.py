# SPDX-License-Identifier: GPL-3.0-or-later
"""Transducer arrays, their drive, and the sound field they produce."""
