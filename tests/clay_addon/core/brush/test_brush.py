# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush, given events like Blender's."""

from itertools import pairwise

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tools.tools import TOOLS
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import SPACING, TICK, Mouse

TOUCHING = [tool.identifier for tool in TOOLS if tool.path != "edit"]


def tip(poses: list) -> np.ndarray:
    """Location of the first mesh's origin [m]."""
    return poses[0][0][:3, 3]


def test_a_press_goes_down_to_its_depth_and_stays(mouse: Mouse) -> None:
    """Stop at strength times radius below the surface, however long the button is held."""
    assert mouse.press()
    for _ in range(120):
        (poses,) = mouse.ticks(1)
        # The tool must not follow clay that yields.
        mouse.clay = mouse.clay - np.array((0.0, 0.0, 1e-4), np.float32)
    assert tip(poses) == pytest.approx((0.0, 0.0, 0.05 - 0.5 * 0.012), abs=4e-4)
    assert poses[0][1]


def test_a_stroke_starts_disabled_and_clear_of_the_clay(mouse: Mouse) -> None:
    """Place the disabled tool outside the clay, then move it no faster than a hand."""
    mouse.press()
    way = mouse.ticks(30)
    assert not way[0][0][1] and all(poses[0][1] for poses in way[1:])
    assert tip(way[0])[2] > 0.05 + 0.5 * SPACING
    steps = [np.linalg.norm(tip(b) - tip(a)) for a, b in pairwise(way)]
    assert max(steps) <= 0.6 * TICK + 1e-9


def test_a_fast_mouse_is_followed_along_the_surface(mouse: Mouse) -> None:
    """Follow a mouse that jumps across the block at a hand's speed, below the surface."""
    mouse.press(-0.03, 0.0)
    mouse.ticks(30)
    mouse.move(0.03, 0.0)
    way = mouse.ticks(20)
    steps = [np.linalg.norm(tip(b) - tip(a)) for a, b in pairwise(way)]
    assert max(steps) <= 0.6 * TICK + 1e-9
    assert all(abs(tip(poses)[2] - 0.044) < 4e-4 for poses in way)
    assert tip(way[-1])[0] == pytest.approx(0.03, abs=7e-4)


def test_releasing_the_button_ends_the_stroke(mouse: Mouse) -> None:
    """End soon after the button is up, and disable the tool."""
    mouse.press()
    mouse.ticks(30)
    assert mouse.send("LEFTMOUSE", "RELEASE")
    mouse.ticks(2)
    assert not mouse.brush.stroking
    assert not any(enabled for poses in mouse.ticks(3) for _, enabled in poses)


def test_a_click_makes_a_full_dent(mouse: Mouse) -> None:
    """Reach the depth even if press and release come between two ticks, then end the stroke."""
    mouse.press()
    mouse.send("LEFTMOUSE", "RELEASE")
    deepest = 1.0
    for _ in range(90):
        (poses,) = mouse.ticks(1)
        deepest = min(deepest, tip(poses)[2])
    assert deepest == pytest.approx(0.044, abs=1e-3)
    assert not mouse.brush.stroking


def test_pressure_sets_the_depth(mouse: Mouse) -> None:
    """Go half as deep at half the pen pressure, unless pressure is not used."""
    mouse.press(is_tablet=True, pressure=1.0)
    mouse.move(0.001, 0.0, is_tablet=True, pressure=0.5)
    assert tip(mouse.ticks(60)[-1])[2] == pytest.approx(0.05 - 0.003, abs=2e-4)
    mouse = Mouse()
    mouse.press(is_tablet=True, pressure=0.2)
    assert tip(mouse.ticks(60)[-1])[2] == pytest.approx(0.05 - 0.0012, abs=2e-4)
    mouse = Mouse()
    mouse.source.set(use_pressure=False)
    mouse.press(is_tablet=True, pressure=0.1)
    assert tip(mouse.ticks(60)[-1])[2] == pytest.approx(0.044, abs=2e-4)


def test_the_wheel_changes_the_depth_only_in_a_stroke(mouse: Mouse) -> None:
    """Consume wheel events during a stroke, and leave them to the view otherwise."""
    mouse.move(0.0, 0.0)
    assert not mouse.send("WHEELDOWNMOUSE")
    mouse.press()
    mouse.ticks(40)
    assert mouse.send("WHEELDOWNMOUSE") and mouse.send("WHEELDOWNMOUSE")
    assert tip(mouse.ticks(40)[-1])[2] == pytest.approx(0.044 - 0.3 * 0.012, abs=2e-4)


def test_beside_the_clay_the_tool_stays_at_its_depth(mouse: Mouse) -> None:
    """Continue parallel to the view where the ray misses, without a jump."""
    mouse.press(0.03, 0.0)
    mouse.ticks(30)
    for x in np.linspace(0.03, 0.09, 20):
        mouse.move(x, 0.0)
        (poses,) = mouse.ticks(1)
    poses = mouse.ticks(30)[-1]
    assert poses[0][1]
    assert tip(poses)[0] > 0.08
    cursor = mouse.brush.cursor
    assert cursor is not None and not cursor.on_clay


def test_over_a_gap_the_tool_is_lifted(mouse: Mouse) -> None:
    """Do not sweep to a surface far below, but lift the disabled tool in between."""
    low = mouse.clay - np.array((0.0, 0.0, 0.2), np.float32)
    low = low[low[:, 0] > 0.0]
    mouse.clay = np.concatenate((mouse.clay[mouse.clay[:, 0] < 0.0], low))
    mouse.press(-0.01, 0.0)
    way = mouse.ticks(30)
    mouse.at = mouse.pixel(0.03, 0.0, -0.15)
    mouse.send("MOUSEMOVE", "NOTHING")
    way += mouse.ticks(60)
    assert tip(way[-1])[2] == pytest.approx(-0.15 - 0.006, abs=5e-4)
    for before, after in pairwise(way):
        if np.linalg.norm(tip(after) - tip(before)) > 0.6 * TICK + 1e-9:
            assert not after[0][1]
            assert tip(after)[2] > -0.15 + 0.5 * SPACING
            break
    else:
        pytest.fail("the tool went through the air at a hand's speed")


def test_the_tool_turns_along_the_stroke(mouse: Mouse) -> None:
    """Point +Z out of the clay and +Y along the stroke, in either direction."""
    mouse.source.set(tool="KNIFE")
    mouse.press(-0.03, 0.0)
    for x in np.linspace(-0.03, 0.03, 40):
        mouse.move(x, 0.0)
        mouse.ticks(1)
    rotation = mouse.ticks(20)[-1][0][0][:3, :3]
    assert rotation[:, 2] @ (0.0, 0.0, 1.0) > 0.99
    assert abs(rotation[:, 1] @ (1.0, 0.0, 0.0)) > 0.99
    assert np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("tool", TOUCHING)
def test_each_tool_has_a_pose_for_each_mesh(mouse: Mouse, tool: str) -> None:
    """Return a finite pose for each mesh, including mirrored ones, throughout a stroke."""
    mouse.source.set(tool=tool, mirror=(True, True, False))
    meshes = mouse.brush.meshes()
    key = mouse.brush.mesh_key
    mouse.press(0.02, 0.01)
    for x in np.linspace(0.02, 0.04, 15):
        mouse.move(x, 0.02)
        for poses in mouse.ticks(2):
            assert len(poses) == len(meshes) and len(meshes) % 4 == 0
            assert all(np.isfinite(pose).all() for pose, _ in poses)
    assert any(enabled for _, enabled in poses)
    assert mouse.brush.mesh_key == key
    for mesh in meshes:
        corners = mesh.vertices[mesh.faces]
        volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        assert volume > 0.0


def test_a_mirrored_copy_is_its_mirror_image(mouse: Mouse) -> None:
    """Mirror vertices about the frame's plane, wherever it is."""
    frame = np.eye(4)
    frame[0, 3] = 0.01
    mouse.source.set(mirror=(True, False, False), mirror_frame=frame)
    mouse.press(0.035, 0.01)
    (first, _), (second, enabled) = mouse.ticks(30)[-1]
    points = mouse.brush.meshes()[0].vertices
    one = points @ first[:3, :3].T + first[:3, 3]
    other = points @ second[:3, :3].T + second[:3, 3]
    assert enabled
    assert np.allclose(other, one * (-1.0, 1.0, 1.0) + (0.02, 0.0, 0.0), atol=1e-12)


def test_on_the_mirror_plane_there_is_one_tool(mouse: Mouse) -> None:
    """Snap a tool near the plane onto it, and disable its copy."""
    mouse.source.set(mirror=(True, False, False))
    mouse.press(0.002, 0.0)
    first, second = mouse.ticks(30)[-1]
    assert first[1] and not second[1]
    assert first[0][0, 3] == pytest.approx(0.0, abs=1e-9)


def test_a_wire_lies_along_the_view(mouse: Mouse) -> None:
    """Extend the wire through the clay along the cursor's ray."""
    mouse.source.set(tool="WIRE")
    assert mouse.press(-0.09, 0.0)
    for x in np.linspace(-0.09, 0.09, 60):
        mouse.move(x, 0.0)
        mouse.ticks(1)
    pose = mouse.ticks(30)[-1][0][0]
    ends = (np.array(((0, 0, -0.5, 1), (0, 0, 0.5, 1))) @ pose.T)[:, :3]
    assert min(ends[:, 2]) < -0.06 and max(ends[:, 2]) > 0.06
    way = ends[1] - ends[0]
    eye = np.array((0.0, 0.0, 0.6))
    aside = np.cross(eye - ends[0], way) / np.linalg.norm(way)
    assert np.linalg.norm(aside) < 1e-3


def test_a_pinch_closes_holds_and_pulls(mouse: Mouse) -> None:
    """Move in while open, close on the clay, then pull away from the surface with the wheel."""
    mouse.source.set(tool="PINCH")
    mouse.press()
    gaps = [np.linalg.norm(tip(p) - tip(p[1:])) for p in mouse.ticks(120)]
    assert gaps[5] == pytest.approx(2 * 1.6 * 0.012, rel=1e-6)
    assert gaps[-1] == pytest.approx(2 * (0.5 * 0.6 * 0.012 + 0.5 * SPACING), rel=1e-6)
    assert all(b <= a + 1e-12 for a, b in pairwise(gaps[5:]))
    before = tip(mouse.ticks(1)[0])[2]
    for _ in range(5):
        mouse.send("WHEELUPMOUSE")
    assert tip(mouse.ticks(60)[-1])[2] == pytest.approx(before + 5 * 0.4 * 0.012, abs=2e-4)


def test_a_pinch_closes_before_it_pulls(mouse: Mouse) -> None:
    """Move in and close first, however early the wheel is turned."""
    mouse.source.set(tool="PINCH")
    mouse.press()
    mouse.ticks(2)
    for _ in range(5):
        mouse.send("WHEELUPMOUSE")
    way = mouse.ticks(120)
    gaps = [np.linalg.norm(tip(p) - tip(p[1:])) for p in way]
    closed = int(np.argmin(np.abs(np.array(gaps) - gaps[-1]) > 1e-9))
    assert tip(way[closed])[2] < 0.05 - 0.5 * 0.7 * 0.012
    assert tip(way[-1])[2] > tip(way[closed])[2] + 0.02


def test_shift_pulls_a_pinch_away_from_the_surface(mouse: Mouse) -> None:
    """Move along the normal while Shift is held, without a jump when it is released."""
    mouse.source.set(tool="PINCH")
    mouse.press()
    before = mouse.ticks(120)[-1]
    mouse.move(0.0, 0.02, shift=True)
    pulled = mouse.ticks(60)[-1]
    assert tip(pulled)[2] - tip(before)[2] == pytest.approx(0.02, abs=1e-3)
    assert tip(pulled)[:2] == pytest.approx(tip(before)[:2], abs=1e-4)
    mouse.move(0.0, 0.02)
    assert tip(mouse.ticks(20)[-1]) == pytest.approx(tip(pulled), abs=1e-4)


def test_a_stamp_stays_where_it_was_set_down(mouse: Mouse) -> None:
    """Press straight in, wherever the mouse moves."""
    mouse.source.set(tool="STAMP")
    mouse.press(0.01, 0.01)
    first = tip(mouse.ticks(1)[0])
    mouse.move(0.03, 0.03)
    assert tip(mouse.ticks(30)[-1])[:2] == pytest.approx(first[:2], abs=1e-4)


def test_a_rolling_pin_rolls(mouse: Mouse) -> None:
    """Turn by distance over radius, so that the pin rolls without slipping."""
    mouse.source.set(tool="ROLLING_PIN")
    mouse.press(0.0, -0.02)
    before = mouse.ticks(80)[-1][0][0]
    for y in np.linspace(-0.02, 0.02, 40):
        mouse.move(0.0, y)
        mouse.ticks(1)
    after = mouse.ticks(20)[-1][0][0]
    turn = after[:3, :3] @ before[:3, :3].T
    angle = np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
    assert angle == pytest.approx(2 * np.pi - 0.04 / 0.012, abs=0.05)
    # Its axis has moved with the mouse, at the same height.
    middle = np.array((0.0, 0.0, 0.012, 1.0))
    assert (after @ middle)[1] == pytest.approx(0.02, abs=1e-3)
    assert (after @ middle)[2] == pytest.approx((before @ middle)[2], abs=2e-4)


def test_a_changed_radius_scales_poses_and_keeps_meshes(mouse: Mouse) -> None:
    """Keep the meshes when the radius changes, except for blades."""
    mouse.move(0.0, 0.0)
    meshes, key = mouse.brush.meshes(), mouse.brush.mesh_key
    mouse.source.set(radius=0.024)
    pose = mouse.ticks(1)[0][0][0]
    assert mouse.brush.mesh_key == key and mouse.brush.meshes()[0] is meshes[0]
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(8.0)
    mouse.source.set(tool="KNIFE")
    key = mouse.brush.mesh_key
    mouse.source.set(radius=0.012)
    assert mouse.brush.mesh_key != key


def test_escape_ends_a_stroke_and_then_reaches_the_operator(mouse: Mouse) -> None:
    """Consume Esc only during a stroke."""
    mouse.move(0.0, 0.0)
    assert not mouse.send("ESC")
    mouse.press()
    mouse.ticks(5)
    assert mouse.send("ESC")
    assert not mouse.brush.stroking
    assert not any(enabled for _, enabled in mouse.ticks(1)[0])
    assert not mouse.send("ESC")
