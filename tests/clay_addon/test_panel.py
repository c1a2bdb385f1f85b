# SPDX-License-Identifier: GPL-3.0-or-later
"""The Clay tab draws for any scene and says what is wrong."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

from tactile_clay.clay_addon import panel
from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.deliver import panel as delivery_panel


class Layout:
    """Records the texts that a panel draws."""

    def __init__(self, texts: list[str]) -> None:
        self.texts = texts

    def __getattr__(self, name: str) -> Any:
        if name in ("row", "column", "box"):
            return lambda **_: Layout(self.texts)
        return self.record

    def record(self, *_: Any, text: str = "", **__: Any) -> SimpleNamespace:
        """Keep a text and return an object on which operator options can be set."""
        self.texts.append(text)
        return SimpleNamespace()


def drawn(cls: Any) -> str:
    """Draw a panel and return its texts."""
    panel._cache_states.clear()
    layout = Layout([])
    cls.draw(SimpleNamespace(layout=layout), bpy.context)
    return " ".join(layout.texts)


def test_clay_converted_to_a_mesh_is_no_longer_clay(studio: Any) -> None:
    """Draw the panel when the active object was clay and is now a mesh."""
    studio.select(studio.clay())
    assert "64 particles, 10 mm apart" in drawn(panel.CLAY_PT_clay)
    bpy.ops.object.convert(target="MESH")
    assert "particles" not in drawn(panel.CLAY_PT_clay)


def test_reason_that_prevents_a_bake_is_shown(studio: Any, tmp_path: Path) -> None:
    """Distinguish the reasons why there is no cache folder."""
    studio.clay()
    assert "never saved" in drawn(panel.CLAY_PT_bake)
    studio.save(tmp_path)
    assert "Not baked yet." in drawn(panel.CLAY_PT_bake)
    studio.scene.tactile_clay.cache_directory = ""
    assert "No cache folder is set" in drawn(panel.CLAY_PT_bake)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_stale_bake_is_reported(studio: Any, tmp_path: Path, scale: float) -> None:
    """Name what has changed, or why the clay cannot be simulated at all."""
    clay = studio.falling_block(tmp_path, end=2)
    bake(bpy.context)
    assert "2 of 2 frames baked" in drawn(panel.CLAY_PT_bake)
    assert "stale" not in drawn(panel.CLAY_PT_bake)
    clay.location.x += 1.0
    clay.scale = (scale, scale, scale)
    bpy.context.view_layer.update()
    expected = "Changed since: clay. Bake again." if scale == 1.0 else "'Clay' is scaled, which"
    assert expected in drawn(panel.CLAY_PT_bake)


def test_delivery_panel_shows_keyed_poses_and_delivery_format(studio: Any, tmp_path: Path) -> None:
    """Hide the panel without clay, count keyed poses, and name the delivery format."""
    assert not delivery_panel.CLAY_PT_delivery.poll(bpy.context)
    studio.clay()
    studio.save(tmp_path)
    assert "keyed" not in drawn(delivery_panel.CLAY_PT_delivery)
    bpy.ops.clay.pose_key()
    assert "1 pose keyed" in drawn(delivery_panel.CLAY_PT_delivery)
    assert "Bake to USD" in drawn(delivery_panel.CLAY_PT_delivery)
    studio.scene.tactile_clay.delivery_kind = "abc"
    assert "Bake to Alembic" in drawn(delivery_panel.CLAY_PT_delivery)
