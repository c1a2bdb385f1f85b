# SPDX-License-Identifier: GPL-3.0-or-later
"""The implicit solve: conjugate gradients with a coarse space of rigid motions."""
