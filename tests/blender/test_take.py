# SPDX-License-Identifier: GPL-3.0-or-later
"""A stroke that is recorded in a real Blender's window, played, and baked again."""

from pathlib import Path
from typing import Any

from .test_sculpt import COMMON, STEPS

RECORDED = """
clay_activity = importlib.import_module(MODULE + ".clay_addon.base.activity").clay_activity

def top_of(item):
    values = np.empty((len(item.data.points), 3), np.float32)
    item.data.attributes["position"].data.foreach_get("vector", values.ravel())
    found = values + np.array(item.matrix_world.translation)
    return float(found[np.hypot(found[:, 0], found[:, 1]) < 0.012, 2].max())

def steps():
    make_block()
    yield 0.5
    bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[0])
    window = bpy.context.window_manager.windows[0]
    scene = window.scene
    scene.tactile_clay.record_take = True
    start()
    yield moves
    yield from press((0.0, 0.0, 0.06))
    yield after(0.1)
    key("ESC")
    yield lambda: sculpting.session is None
    scene = window.scene
    last = scene.frame_end
    pressed = top_of(clay())
    print("TAKE", last > 8, scene.frame_current == last, flush=True)
    print("FOLDER", scene.tactile_clay.cache_directory, flush=True)
    scene.frame_set(1)
    print("BEFORE", top_of(clay()) > pressed + 0.004, flush=True)
    scene.frame_set(last)
    print("AFTER", abs(top_of(clay()) - pressed) < 1e-5, flush=True)
    with in_view():
        assert bpy.ops.clay.bake_again("EXEC_DEFAULT", spacing=0.006) == {"FINISHED"}
    film = window.scene
    print("FILM", film.name, clay_activity.kind is not None, flush=True)
    yield lambda: clay_activity.kind is None
    film.frame_set(film.frame_end)
    fine = film.objects["Clay (film)"]
    print("BAKED", abs(top_of(fine) - pressed) < 0.001, top_of(fine), pressed, flush=True)
    screenshot(ARGUMENTS[1])
    bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[0])

run(steps())
"""


def test_recorded_stroke_plays_and_bakes_again(blender_with_extension: Any) -> None:
    """Sculpt with Record on, play the stroke, and press Bake Again."""
    folder: Path = blender_with_extension.folder
    picture, file = folder / "film.png", folder / "take.blend"
    script = STEPS + COMMON + RECORDED
    result = blender_with_extension.run_script(script, file, picture, window=True, timeout=600.0)
    assert result.exit_code == 0, result.output
    for line in ("TAKE True True", "BEFORE True", "AFTER True", "FILM Scene film True"):
        assert line in result.output, result.output
    assert "BAKED True" in result.output, result.output
    assert "FOLDER //clay_cache_take_001" in result.output
    assert len(list((folder / "clay_cache_take_001").glob("take_0*.npz"))) >= 1
    assert picture.stat().st_size > 20_000
