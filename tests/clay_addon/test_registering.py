# SPDX-License-Identifier: GPL-3.0-or-later
"""Registering adds to Blender what it should, and unregistering removes all of it."""

import importlib.util
import subprocess
import sys
from typing import Any

import bpy
import pytest

import tactile_clay
from tactile_clay import clay_addon
from tactile_clay.clay_addon.base import preferences

OPERATORS = ("make", "collider_add", "collider_remove", "bake", "resume", "free")


def added() -> dict[str, Any]:
    """What the add-on has added to Blender."""
    return {
        "classes": sorted(name for name in dir(bpy.types) if name.startswith(("CLAY_", "Clay"))),
        "properties": [
            hasattr(kind, "tactile_clay") for kind in (bpy.types.Object, bpy.types.Scene)
        ],
        "handlers": sum(
            handler.__module__.startswith("tactile_clay")
            for name in dir(bpy.app.handlers)
            if isinstance(handlers := getattr(bpy.app.handlers, name), list)
            for handler in handlers
        ),
    }


def test_unregister_removes_everything_twice_in_a_row() -> None:
    """Leave Blender as it was, however often register and unregister are called."""
    before = added()
    assert before["properties"] == [False, False]
    seen = []
    for _ in range(2):
        tactile_clay.register()
        tactile_clay.register()
        seen.append(added())
        tactile_clay.unregister()
        tactile_clay.unregister()
        assert added() == before
    assert seen[0] == seen[1]
    assert seen[0]["properties"] == [True, True]
    assert {f"CLAY_OT_{name}" for name in OPERATORS} <= set(seen[0]["classes"])


def test_failing_part_leaves_nothing_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unregister the other parts when one fails, so that a second attempt works."""
    before = added()
    monkeypatch.setattr(clay_addon, "_MODULES", (*clay_addon._MODULES, "no_such_part"))
    with pytest.raises(ModuleNotFoundError):
        tactile_clay.register()
    assert added() == before
    monkeypatch.undo()
    tactile_clay.register()
    tactile_clay.unregister()


def test_properties_survive_in_the_file_without_the_addon(studio: Any, tmp_path: Any) -> None:
    """Keep a .blend file's clay properties when it is saved with the add-on disabled."""
    clay = studio.clay()
    clay.tactile_clay.density = 1234.0
    path = studio.save(tmp_path)
    tactile_clay.unregister()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    bpy.ops.wm.save_mainfile()
    tactile_clay.register()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    clay = bpy.context.scene.objects["Clay"]
    assert (clay.tactile_clay.role, clay.tactile_clay.density) == ("CLAY", 1234.0)
    assert clay.tactile_clay.sources[0].source.name == "Cube"


def test_missing_warp_is_named_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Return one message if Warp is missing, and none if nothing is."""
    assert preferences.missing_parts() == []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    (sentence,) = preferences.missing_parts()
    assert "Warp is missing" in sentence
    assert "Install the extension" in sentence


WITHOUT_WARP = """
import os, sys
import bpy

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "warp":
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Block())
bpy.ops.wm.read_factory_settings(use_empty=True)
import tactile_clay
tactile_clay.register()
bpy.ops.mesh.primitive_cube_add(size=0.04)
for operator in (bpy.ops.clay.make, bpy.ops.clay.bake):
    try:
        operator()
    except RuntimeError as error:
        print(error)
print(bpy.ops.clay.collider_add())
tactile_clay.unregister()
sys.stdout.flush()
os._exit(0)
"""


def test_without_warp_operators_say_so() -> None:
    """Register without Warp; the operators that need it report that it is missing."""
    result = subprocess.run(
        [sys.executable, "-c", WITHOUT_WARP], capture_output=True, text=True, timeout=120
    )
    assert result.returncode == 0, result.stderr
    assert "NVIDIA Warp is missing" in result.stdout
    assert "{'FINISHED'}" in result.stdout
