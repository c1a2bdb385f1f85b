# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush of a live session, without Blender: from mouse events to poses of a tool.

An event goes to the queue of `input`. At the tick, the session hands the clay to `brush`, which
takes from the queue, moves its `stroke` or `edit_stroke` along the `surface_path` found by
`raycast`, and returns the `tool_poses` for the solver.
"""
