# SPDX-License-Identifier: GPL-3.0-or-later
"""The properties that a .blend stores about its clay, and how to read and write them."""
