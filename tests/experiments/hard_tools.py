# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases with tools: too fast, too thin, in the wrong place."""

from dataclasses import replace

import numpy as np
import trimesh

from tactile_clay.solver.geometry.closed_mesh import MeshError

from .shapes import at, ball, block
from .survival import RELEASE_SPEED, SPACING, HardCase, on_table, survive


def two_plates() -> HardCase:
    """Squeeze a block between plates to 30 % of its height, then to 5 %."""
    scene = on_table(block(7, SPACING))
    box = trimesh.creation.box((0.2, 0.2, 0.02))
    plate = scene.add_mesh(box.vertices, box.faces)
    top, speed = 7 * SPACING, 0.05
    plate.set_pose(at(0, 0, top + 0.011))
    stops = (0.3 * top, 0.05 * top)
    down = [round((top - stop) / speed * 60) for stop in stops]

    def drive(frame: int) -> None:
        height = max(top - speed * (frame + 1) / 60, stops[0])
        if frame > down[0] + 10:
            height = max(stops[0] - speed * (frame - down[0] - 10) / 60, stops[1])
        plate.set_pose(at(0, 0, height + 0.01))

    # Outflow speed of the clay between the plates: v L / 2 h with the squeezed width, at 5 %.
    outward = speed * 0.5 * (7 * SPACING / 0.05**0.5) / stops[1]
    return survive(scene, down[1] + 40, speed_in=max(outward, RELEASE_SPEED), drive=drive)


def tool_jumps_inside() -> HardCase:
    """Let a tool jump from far away into the middle of a block."""
    scene = on_table(block(8, SPACING))
    sphere = ball(0.012)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 3.0))

    def drive(frame: int) -> None:
        if frame == 5:
            tool.set_pose(at(0, 0, 0.02))

    return survive(scene, 90, drive=drive, note="24 mm ball into a 40 mm block")


def inside_a_tool() -> HardCase:
    """Start with a block entirely inside a box."""
    scene = on_table(block(5, SPACING, (0, 0, 0.02)))
    box = trimesh.creation.box((0.06, 0.06, 0.06))
    scene.add_mesh(box.vertices, box.faces).set_pose(at(0, 0, 0.03))
    return survive(scene, 150, note="25 mm block in a 60 mm box")


def flat_tool() -> HardCase:
    """Add a tool of two coincident opposite faces: refused with a message."""
    scene = on_table(block(4, SPACING))
    square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * 0.02
    faces = [(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)]
    try:
        scene.add_mesh(square, faces)
    except MeshError as error:
        return survive(scene, 30, note=f"refused: {error}")
    return survive(scene, 30, note="accepted as a collider")


def thin_tool(thickness: float = 1e-6) -> HardCase:
    """Press a plate a micrometer thick into a block."""
    scene = on_table(block(6, SPACING))
    box = trimesh.creation.box((0.02, 0.02, thickness))
    plate = scene.add_mesh(box.vertices, box.faces)
    plate.set_pose(at(0, 0, 0.033))

    def drive(frame: int) -> None:
        plate.set_pose(at(0, 0, max(0.033 - 0.0008 * frame, 0.025)))

    return survive(scene, 60, drive=drive, note=f"{thickness:g} m thick")


def fast_tool(speed: float = 20.0) -> HardCase:
    """Shoot a ball through a block, and stop it behind."""
    scene = on_table(block(8, SPACING))
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    start = -0.2
    tool.set_pose(at(start, 0, 0.025))

    def drive(frame: int) -> None:
        tool.set_pose(at(min(start + speed * (frame + 1) / 60, 0.2), 0, 0.025))

    return survive(scene, 120, speed_in=speed, calm=0.05, drive=drive, note=f"{speed:g} m/s")


def tool_pose_not_finite() -> HardCase:
    """Set poses and vertices that are not finite: refused, and the last good ones are kept."""
    scene = on_table(block(4, SPACING))
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    good = at(0, 0, 0.035)
    tool.set_pose(good)
    refused = 0

    def drive(frame: int) -> None:
        nonlocal refused
        bad = good.copy()
        bad[frame % 3, frame % 4] = (np.nan, np.inf)[frame % 2]
        for change in (
            lambda: tool.set_pose(bad),
            lambda: tool.set_vertices(np.full_like(sphere.vertices, np.nan)),
        ):
            try:
                change()
            except ValueError:
                refused += 1

    result = survive(scene, 30, drive=drive)
    held = bool(np.array_equal(tool.pose, good)) and refused == 60
    return replace(result, recovered=result.recovered and held, note=f"{refused} of 60 refused")
