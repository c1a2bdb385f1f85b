# SPDX-License-Identifier: GPL-3.0-or-later
"""A smooth surface that keeps up with clay worked live."""
