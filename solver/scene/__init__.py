# SPDX-License-Identifier: GPL-3.0-or-later
"""The contents of a simulation, the materials of clay, and the settings of the solver."""
