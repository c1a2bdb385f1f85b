# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in a simulation, what clay is made of, and how finely it is solved."""
