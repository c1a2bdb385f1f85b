# SPDX-License-Identifier: GPL-3.0-or-later
"""The Clay tab: that it draws whatever the scene holds, and says what is wrong."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

from tactile_clay.clay_addon import panel
from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.deliver import panel as delivery_panel


class Layout:
    """Takes down the texts that a panel draws."""

    def __init__(self, texts: list[str]) -> None:
        self.texts = texts

    def __getattr__(self, name: str) -> Any:
        if name in ("row", "column", "box"):
            return lambda **_: Layout(self.texts)
        return self.take_down

    def take_down(self, *_: Any, text: str = "", **__: Any) -> SimpleNamespace:
        """Keep a text; a button hands back its operator's options, to be set."""
        self.texts.append(text)
        return SimpleNamespace()


def drawn(cls: Any) -> str:
    """Draw a panel and return its texts."""
    panel._glance.clear()
    layout = Layout([])
    cls.draw(SimpleNamespace(layout=layout), bpy.context)
    return " ".join(layout.texts)


def test_clay_converted_to_a_mesh_is_no_clay(studio: Any) -> None:
    """Draw the panel when the active object was clay and is a mesh now."""
    studio.select(studio.clay())
    assert "64 particles, 10 mm apart" in drawn(panel.CLAY_PT_clay)
    bpy.ops.object.convert(target="MESH")
    assert "particles" not in drawn(panel.CLAY_PT_clay)


def test_what_keeps_a_bake_from_starting_is_told(studio: Any, tmp_path: Path) -> None:
    """Say why there is no cache folder, each reason in its own words."""
    studio.clay()
    assert "never saved" in drawn(panel.CLAY_PT_bake)
    studio.save(tmp_path)
    assert "Not baked yet." in drawn(panel.CLAY_PT_bake)
    studio.scene.tactile_clay.cache_directory = ""
    assert "No cache folder is set" in drawn(panel.CLAY_PT_bake)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_stale_bake_is_told(studio: Any, tmp_path: Path, scale: float) -> None:
    """Name what has changed, or what keeps the clay from being simulated at all."""
    clay = studio.falling_block(tmp_path, end=2)
    bake(bpy.context)
    assert "2 of 2 frames baked" in drawn(panel.CLAY_PT_bake)
    assert "stale" not in drawn(panel.CLAY_PT_bake)
    clay.location.x += 1.0
    clay.scale = (scale, scale, scale)
    bpy.context.view_layer.update()
    expected = (
        "the scene has changed: clay. Bake again." if scale == 1.0 else "'Clay' is scaled, so"
    )
    assert expected in drawn(panel.CLAY_PT_bake)


def test_delivery_tells_what_is_keyed_and_delivered(studio: Any, tmp_path: Path) -> None:
    """Offer only what there is something for: poses to remove, a delivery to take back."""
    assert not delivery_panel.CLAY_PT_delivery.poll(bpy.context)
    studio.clay()
    studio.save(tmp_path)
    assert "keyed" not in drawn(delivery_panel.CLAY_PT_delivery)
    bpy.ops.clay.pose_key()
    assert "1 pose keyed" in drawn(delivery_panel.CLAY_PT_delivery)
    assert "Bake to USD" in drawn(delivery_panel.CLAY_PT_delivery)
    studio.scene.tactile_clay.delivery_kind = "abc"
    assert "Bake to Alembic" in drawn(delivery_panel.CLAY_PT_delivery)
