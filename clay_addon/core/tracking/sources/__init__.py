# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources of hands, one module per tracker; each runs in a sender process."""
