# SPDX-License-Identifier: GPL-3.0-or-later
"""The joints of a hand, the datagram that carries them, and its receiver."""
