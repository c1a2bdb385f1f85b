# SPDX-License-Identifier: GPL-3.0-or-later
"""The default clay model: bonds that yield by stress, solved implicitly."""
