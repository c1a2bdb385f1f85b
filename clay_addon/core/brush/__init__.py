# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush of a live session, without Blender: from mouse events to poses of a tool.

Events go to the queue in `input`. At each tick, the session passes the clay to `brush`, which
empties the queue, moves its `stroke` or `edit_stroke` along the `surface_path` found by `raycast`,
and returns the `tool_poses` for the solver.
"""
