# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints, the datagram that carries them, and its receiver."""
