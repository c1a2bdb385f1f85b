# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in motion: bones lead, flesh follows and yields, clay pushes back."""
