# SPDX-License-Identifier: GPL-3.0-or-later
"""The datagrams between a simulation and the array server."""
