# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in motion: elastic flesh on moving bones, in contact with clay."""
