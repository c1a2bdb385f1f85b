# SPDX-License-Identifier: GPL-3.0-or-later
"""The step that settings speak of."""

BASE_STEP = 1.0 / 60.0
"""The step that `Settings.substeps` divides [s]."""
