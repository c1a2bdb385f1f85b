# SPDX-License-Identifier: GPL-3.0-or-later
"""Data and files of a take, the recording of a live session."""
