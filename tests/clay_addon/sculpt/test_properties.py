# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush properties of a scene, and how a brush reads them."""

from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.core.tools.tools import TOOLS
from tactile_clay.clay_addon.sculpt import header, operators, panel, properties
from tactile_clay.clay_addon.sculpt.live.current import current
from tactile_clay.clay_addon.sculpt.properties import SceneSource, stamp_fault


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_default_radius_is_that_of_a_fingertip_at_any_scale(studio: Any, scale: float) -> None:
    """Start with 12 mm at any unit scale, and read a set value in meters."""
    studio.scene.unit_settings.scale_length = scale
    brush = studio.scene.tactile_clay_sculpt
    assert brush.radius * scale == pytest.approx(0.012)
    source = SceneSource(studio.scene)
    source.write("radius", 0.02)
    assert brush.radius * scale == pytest.approx(0.02)
    assert source.read().radius == pytest.approx(0.02)
    assert source.read().scale == pytest.approx(scale)


def test_current_settings_of_a_scene_are_read(studio: Any) -> None:
    """Read tool, strength, mirror axes, color, and the clay's spacing and location."""
    clay = studio.clay(location=(0.1, 0.2, 0.3))
    brush = studio.scene.tactile_clay_sculpt
    brush.tool, brush.strength, brush.mirror_y = "KNIFE", 0.25, True
    brush.color = (0.1, 0.2, 0.3)
    settings = SceneSource(studio.scene).read()
    assert settings.tool.identifier == "KNIFE"
    assert settings.strength == 0.25
    assert settings.mirror == (False, True, False)
    assert settings.color == pytest.approx((0.1, 0.2, 0.3, 1.0))
    assert settings.spacing == pytest.approx(0.01)
    assert np.allclose(settings.mirror_frame[:3, 3], clay.matrix_world.translation)


def test_mirror_follows_the_active_clay(studio: Any) -> None:
    """Mirror about the active clay object's local planes."""
    studio.clay("A")
    other = studio.clay("B", location=(0.5, 0.0, 0.0))
    other.rotation_euler.z = 0.3
    bpy.context.view_layer.update()
    studio.select(other)
    frame = SceneSource(studio.scene).read().mirror_frame
    assert np.allclose(frame[:3, 3], (0.5, 0.0, 0.0), atol=1e-6)
    assert abs(frame[:3, 0] @ (np.cos(0.3), np.sin(0.3), 0.0)) == pytest.approx(1.0)


def test_object_can_be_a_stamp(studio: Any) -> None:
    """Use a closed mesh as stamp, with its own key, and say why an open one cannot be used."""
    brush = studio.scene.tactile_clay_sculpt
    brush.tool = "STAMP"
    source = SceneSource(studio.scene)
    assert source.read().stamp is None
    brush.stamp = studio.block(size=0.3)
    settings = source.read()
    assert settings.stamp is not None and len(settings.stamp.vertices) == 8
    assert settings.stamp_key
    bpy.ops.mesh.primitive_plane_add()
    brush.stamp = bpy.context.object
    assert source.read().stamp is None and source.read().stamp_key == ""
    assert "open" in stamp_fault(brush.stamp)


def test_deleted_scene_leaves_the_last_settings(studio: Any) -> None:
    """Keep returning the last settings after the scene is deleted."""
    scene = bpy.data.scenes.new("Other")
    scene.tactile_clay_sculpt.strength = 0.75
    source = SceneSource(scene)
    source.read()
    bpy.data.scenes.remove(scene)
    assert source.read().strength == 0.75
    source.write("strength", 0.1)


def test_undo_does_not_change_the_brush(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Preserve the brush across Undo while a session runs, and only then."""
    brush = studio.scene.tactile_clay_sculpt
    for running, expected in ((object(), "WIRE"), (None, "PALM")):
        monkeypatch.setattr(current, "session", running)
        brush.tool = "WIRE"
        properties._before_undo()
        brush.tool = "PALM"
        properties._after_undo()
        assert brush.tool == expected


class Layout:
    """Records what is drawn."""

    def __init__(self, drawn: list[str]) -> None:
        self.drawn = drawn

    def __getattr__(self, name: str) -> Any:
        if name in ("row", "column", "box"):
            return lambda **_: Layout(self.drawn)
        return self._record

    def _record(self, *names: Any, text: str = "", **_: Any) -> Any:
        self.drawn.append(str(names[-1]) if names else text)
        return SimpleNamespace()


@pytest.mark.parametrize("compact", [True, False])
@pytest.mark.parametrize("tool", [tool.identifier for tool in TOOLS])
def test_each_tool_shows_its_settings(studio: Any, tool: str, compact: bool) -> None:
    """Offer a color for clay and paint, a mesh for a stamp, and nothing for no tool."""
    brush = studio.scene.tactile_clay_sculpt
    brush.tool = tool
    drawn: list[str] = []
    header.draw_brush(Layout(drawn), brush, compact=compact)
    assert ("color" in drawn) == (tool in ("ADD", "PAINT"))
    assert ("stamp" in drawn) == (tool == "STAMP")
    assert ("radius" in drawn) == (tool != "NONE")
    assert ("strength" in drawn) == (tool not in ("NONE", "WIRE"))
    assert "CLAY_MT_sculpt_tools" in drawn


def running_at(factor: float, *, started: bool = True, compiling: float = 0.0) -> Any:
    """A stand-in for a session that runs at a factor of real time."""
    return SimpleNamespace(
        factor=factor,
        pace=SimpleNamespace(started=started),
        messages=["A message"],
        wheels=None,
        compiling_seconds=compiling,
    )


def test_panel_offers_to_start_or_finish(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Show the appropriate button, and the speed of simulated time."""
    studio.clay()
    for running, button in ((None, "clay.sculpt"), (running_at(0.5), "clay.sculpt_finish")):
        monkeypatch.setattr(current, "session", running)
        drawn: list[str] = []
        drawing: Any = SimpleNamespace(layout=Layout(drawn))
        panel.CLAY_PT_sculpt.draw(drawing, bpy.context)
        assert button in drawn
    assert panel.speed_text(running_at(0.5)) == "50% of real time"
    assert panel.speed_text(running_at(0.99)) == "Real time"
    assert panel.speed_text(running_at(1.0, started=False)) == "Getting ready …"


def test_status_bar_describes_the_session() -> None:
    """Mention compilation, slow simulated time, and what the mouse does."""
    brush: Any = SimpleNamespace(status_text=lambda: "Left mouse: Finger")
    assert "Compiling the clay's kernels: 8 s" in operators.status_text(
        running_at(1.0, compiling=8.0), brush
    )
    assert operators.status_text(running_at(1.0), brush) == "Sculpting   Left mouse: Finger"
    assert "at 40 % of real time" in operators.status_text(running_at(0.42), brush)


def test_tool_is_chosen_without_an_undo_step(studio: Any) -> None:
    """Change tools with an operator that makes no undo step."""
    assert bpy.ops.clay.sculpt_tool(tool="LOOP") == {"FINISHED"}
    assert studio.scene.tactile_clay_sculpt.tool == "LOOP"
    assert "UNDO" not in header.CLAY_OT_sculpt_tool.bl_options
