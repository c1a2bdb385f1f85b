# SPDX-License-Identifier: GPL-3.0-or-later
"""Which events a brush consumes, which it leaves to Blender, and what its keys do."""

import numpy as np
import pytest

from tactile_clay.tests.clay_addon.core.brush.fake_mouse import Mouse


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("MIDDLEMOUSE", {}),
        ("MIDDLEMOUSE", {"shift": True}),
        ("LEFTMOUSE", {"alt": True}),
        ("LEFTMOUSE", {"shift": True}),
        ("LEFTMOUSE", {"ctrl": True}),
        ("RIGHTMOUSE", {}),
        ("WHEELUPMOUSE", {}),
        ("TRACKPADPAN", {}),
        ("NUMPAD_1", {}),
        ("Z", {"ctrl": True}),
        ("F", {"ctrl": True}),
        ("TIMER", {}),
    ],
)
def test_blenders_own_events_are_not_consumed(mouse: Mouse, kind: str, more: dict) -> None:
    """Leave navigation, Undo and selection to Blender."""
    mouse.move(0.0, 0.0)
    assert not mouse.send(kind, **more)
    assert not mouse.brush.stroking


def test_timer_events_pass_through_during_a_stroke(mouse: Mouse) -> None:
    """Pass on the session's timer while the button is held, but not view navigation."""
    mouse.press()
    assert not mouse.send("TIMER", "NOTHING")
    assert mouse.send("MIDDLEMOUSE")


@pytest.mark.parametrize("place", ["panel", "gizmo", "button", "outside"])
def test_clicks_outside_the_view_are_not_consumed(mouse: Mouse, place: str) -> None:
    """Leave clicks on panels, the gizmo, its buttons and other editors to Blender."""
    mouse.at = {
        "panel": (850, 300), "gizmo": (760, 600), "button": (775, 500), "outside": (50, 20)
    }[place]  # fmt: skip
    assert not mouse.send("LEFTMOUSE")
    mouse.area.spaces.active.show_gizmo = False
    assert mouse.send("LEFTMOUSE") == (place in ("gizmo", "button"))


def test_each_quarter_of_a_quad_view_has_its_own_ray(mouse: Mouse) -> None:
    """Use the quarter under the mouse."""
    from copy import copy

    mouse.region.width = mouse.region.height = 300
    other = copy(mouse.region)
    other.x = 500
    mouse.area.regions.append(other)
    for x in (250, 650):
        mouse.at = (x, 200)
        mouse.send("MOUSEMOVE", "NOTHING")
        mouse.ticks(1)
        cursor = mouse.brush.cursor
        assert cursor is not None
        assert cursor.point == pytest.approx((0.0, 0.0, 0.05), abs=2e-3)


def test_without_a_tool_nothing_is_consumed(mouse: Mouse) -> None:
    """Consume no press and draw nothing if no tool is chosen."""
    mouse.source.set(tool="NONE")
    assert not mouse.press()
    assert mouse.ticks(1) == [[]]
    assert mouse.brush.drawn() == []


def test_a_press_in_empty_space_pushes_from_the_side(mouse: Mouse) -> None:
    """Start beside the clay, at the depth of the nearest particle."""
    assert mouse.press(-0.08, 0.0)
    mouse.ticks(10)
    poses = mouse.ticks(20)[-1]
    assert poses[0][1]
    assert abs(poses[0][0][2, 3]) < 0.06


def test_f_changes_the_radius_as_blenders_brushes_do(mouse: Mouse) -> None:
    """Scale the radius with the mouse travel, show the value, and confirm with the button."""
    mouse.move(0.0, 0.0)
    mouse.ticks(1)
    assert mouse.send("F")
    assert "12 mm" in mouse.header
    mouse.move(0.006, 0.0)
    assert mouse.source.settings.radius == pytest.approx(0.018, rel=0.05)
    cursor = mouse.brush.cursor
    mouse.ticks(1)
    # The ring stays in place while its size is adjusted.
    assert mouse.brush.cursor is cursor
    assert mouse.send("LEFTMOUSE")
    assert mouse.header == "" and mouse.brush.adjustment is None
    assert not mouse.brush.stroking
    assert mouse.source.settings.radius == pytest.approx(0.018, rel=0.05)


@pytest.mark.parametrize("key", ["ESC", "RIGHTMOUSE"])
def test_an_adjustment_can_be_canceled(mouse: Mouse, key: str) -> None:
    """Restore the previous value when F or Shift F is canceled."""
    mouse.move(0.0, 0.0)
    mouse.send("F", shift=True)
    mouse.move(0.05, 0.0)
    assert mouse.source.settings.strength > 0.7
    assert mouse.send(key)
    assert mouse.source.settings.strength == 0.5
    assert mouse.header == ""


def test_brackets_step_the_radius(mouse: Mouse) -> None:
    """Make the brush larger and smaller by the same factor."""
    mouse.move(0.0, 0.0)
    assert mouse.send("RIGHT_BRACKET")
    assert mouse.source.settings.radius == pytest.approx(0.012 * 1.1)
    assert mouse.send("LEFT_BRACKET")
    assert mouse.source.settings.radius == pytest.approx(0.012)


def test_settings_wait_for_the_end_of_a_stroke(mouse: Mouse) -> None:
    """Keep tool and meshes during a stroke, even if settings change."""
    mouse.press()
    mouse.ticks(5)
    key = mouse.brush.mesh_key
    mouse.source.set(tool="PALM")
    assert mouse.brush.mesh_key == key
    mouse.send("LEFTMOUSE", "RELEASE")
    mouse.ticks(90)
    assert mouse.brush.mesh_key != key


@pytest.mark.parametrize("tool", ["ADD", "REMOVE", "PAINT"])
def test_edits_are_dabs_along_the_stroke(mouse: Mouse, tool: str) -> None:
    """Dab once at even distances, with a mirror image of each dab."""
    mouse.source.set(tool=tool, mirror=(True, False, False), strength=0.75)
    mouse.press(0.01, -0.02)
    mouse.ticks(3)
    for y in np.linspace(-0.02, 0.02, 30):
        mouse.move(0.01, y)
        assert mouse.ticks(1) == [[]]
    edits = mouse.brush.take_edits()
    assert mouse.brush.take_edits() == []
    assert {edit.kind for edit in edits} == {tool.lower()}
    centers = np.array([edit.center for edit in edits])
    first, second = centers[::2], centers[1::2]
    assert np.allclose(second, first * (-1.0, 1.0, 1.0))
    steps = np.linalg.norm(np.diff(first, axis=0), axis=1)
    assert np.allclose(steps, 0.4 * 0.012, atol=2e-4)
    height = {"ADD": -0.25, "REMOVE": 0.25, "PAINT": 0.0}[tool]
    assert np.allclose(first[:, 2], 0.05 + height * 0.012, atol=2e-4)
    assert {edit.strength for edit in edits} == ({0.75} if tool == "PAINT" else {1.0})
    mouse.send("LEFTMOUSE", "RELEASE")
    mouse.ticks(1)
    assert not mouse.brush.stroking


def test_ctrl_inverts_adding(mouse: Mouse) -> None:
    """Invert add and remove as Blender's brushes do, but not paint."""
    mouse.source.set(tool="ADD")
    assert mouse.press(ctrl=True)
    mouse.ticks(1)
    assert [edit.kind for edit in mouse.brush.take_edits()] == ["remove"]
    mouse = Mouse()
    mouse.source.set(tool="PAINT")
    assert not mouse.press(ctrl=True)


def test_positions_are_in_blender_units(mouse: Mouse) -> None:
    """Find the same point in a scene whose unit is a centimeter."""
    mouse.press()
    meters = mouse.ticks(30)[-1][0][0]
    small = Mouse()
    small.context.scene.unit_settings.scale_length = 0.01
    small.source.set(scale=0.01)
    small.clay = mouse.clay * np.float32(100.0)
    data = small.region.data
    view = data.view_matrix.copy()
    view[:3, 3] *= 100.0
    window = data.perspective_matrix @ np.linalg.inv(data.view_matrix)
    data.view_matrix, data.perspective_matrix = view, window @ view
    small.at = mouse.at
    assert small.send("LEFTMOUSE")
    assert np.allclose(small.ticks(30)[-1][0][0], meters, atol=1e-4)


def test_events_wait_for_the_tick(mouse: Mouse) -> None:
    """Queue a press and start its stroke once, with the clay of the next tick."""
    mouse.press()
    assert mouse.brush.stroking
    assert not any(enabled for _, _, enabled in mouse.brush.drawn())
    mouse.clay = mouse.clay + np.array((0.0, 0.0, 0.01), np.float32)
    mouse.ticks(1)
    assert mouse.brush.cursor is not None
    # The surface is that of the clay at the tick, not at the press.
    assert mouse.brush.cursor.point[2] == pytest.approx(0.06, abs=0.002)
    mouse.send("LEFTMOUSE", "RELEASE")
    mouse.ticks(60)
    assert not mouse.brush.stroking
