# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own materials: saved, listed and removed; bad files are reported."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest

from tactile_clay.clay_addon import panel
from tactile_clay.clay_addon.model import material_presets, user_materials
from tactile_clay.clay_addon.model.user_materials import (
    UserMaterialError,
    material_number,
    read_user_materials,
    remove_user_material,
    save_user_material,
)
from tactile_clay.solver import Material

from ..test_panel import drawn

GOOD = "[material]\nyield_stress = 3000.0\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for the user's materials, which does not exist yet."""
    path = tmp_path / "user" / "materials"
    monkeypatch.setattr(user_materials, "user_material_folder", lambda: path)
    user_materials.forget_user_materials()
    yield path
    user_materials.forget_user_materials()


def write(folder: Path, name: str, text: str) -> None:
    """Put a file in the folder, as a user might."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text, encoding="utf-8")
    user_materials.forget_user_materials()


def test_saved_material_reads_back(folder: Path) -> None:
    """Preserve label and values exactly, and leave no other file behind."""
    assert read_user_materials(folder) == user_materials.UserMaterials((), ())
    material = Material(density=1234.5, yield_stress=1 / 3, viscosity=0.0, friction=0.1)
    saved = save_user_material('  Grandma\'s "best"   clay ', material)
    assert saved.label == 'Grandma\'s "best" clay'
    (found,) = read_user_materials(folder).materials
    assert found == saved
    assert [path.name for path in folder.iterdir()] == ["grandma_s_best_clay.toml"]


@pytest.mark.parametrize("label", ["con", "Пластилин", "粘土", "a/../b", "é" * 40, "!?"])
def test_any_printable_label_makes_a_file(folder: Path, label: str) -> None:
    """Find a file name inside the folder for every label, and list the label unchanged."""
    saved = save_user_material(label, Material())
    (found,) = read_user_materials(folder).materials
    assert found == saved
    assert found.label == label
    (path,) = folder.iterdir()
    assert path.stem.isascii()
    assert path.stem != "con"


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("", "needs a name"),
        (" \t ", "needs a name"),
        ("bell\a", "needs a name"),
        ("x" * 41, "has 41 characters; use at most 40"),
        ("Wet Clay", "comes with the extension"),
    ],
)
def test_invalid_label_is_refused(folder: Path, label: str, message: str) -> None:
    """Say what is wrong with a label, and write nothing."""
    with pytest.raises(UserMaterialError, match=message):
        save_user_material(label, Material())
    assert not folder.exists()


def test_taken_name_needs_replace(folder: Path) -> None:
    """Keep the existing material unless `replace` is set."""
    save_user_material("Mine", Material(density=1000.0))
    with pytest.raises(UserMaterialError, match=r"already .* name, or enable Replace"):
        save_user_material("mine", Material(density=2000.0))
    assert read_user_materials(folder).materials[0].material.density == 1000.0
    save_user_material("Mine", Material(density=2000.0), replace=True)
    assert read_user_materials(folder).materials[0].material.density == 2000.0


def test_folder_that_cannot_be_written_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Say which file could not be written, and leave nothing half-written."""
    folder.parent.mkdir(parents=True)
    folder.write_text("in the way")
    with pytest.raises(UserMaterialError, match=r"mine\.toml cannot be written: "):
        save_user_material("Mine", Material())
    folder.unlink()

    def broken(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", broken)
        with pytest.raises(UserMaterialError, match="No space left"):
            save_user_material("Mine", Material())
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[material\n", "bad.toml is not a valid TOML file"),
        ("", r"bad\.toml has no \[material\] table"),
        ("[material]\nstickiness = 1\n", "unknown key 'stickiness'"),
        ("[material]\ndensity = 'heavy'\n", "density is 'heavy'; it must be a number"),
        ("[material]\ndensity = -1\n", r"bad\.toml: Material.density is -1"),
        ("[material]\ndensity = 0.5\n", r"bad\.toml: density is 0\.5; it must be at least 1"),
        ("[material]\nflow_index = 0.01\n", r"bad\.toml: flow_index is 0\.01; it must be at"),
        ("label = 7\n" + GOOD, r"bad\.toml: label is 7"),
    ],
)
def test_bad_file_is_named_and_does_not_hide_good_ones(
    studio: Any, folder: Path, text: str, message: str
) -> None:
    """Show the file and its error in the panel, list the good files, and still register."""
    import tactile_clay

    write(folder, "bad.toml", text)
    write(folder, "fine.toml", GOOD)
    found = read_user_materials(folder)
    assert [each.name for each in found.materials] == ["fine"]
    (problem,) = found.problems
    assert re.search(message, problem)
    assert "Fix or delete the file." in problem
    tactile_clay.unregister()
    tactile_clay.register()
    assert problem in drawn(panel.CLAY_PT_clay)
    assert "fine" in material_presets.material_names()


@pytest.mark.parametrize("name", ["CUSTOM", "SCENE", "plasticine"])
def test_file_with_a_taken_name_is_reported(folder: Path, name: str) -> None:
    """Reject a file with the name of a shipped preset or a reserved name."""
    write(folder, f"{name}.toml", GOOD)
    found = read_user_materials(folder)
    assert found.materials == ()
    assert f"{name}.toml conflicts with the preset {name!r}" in found.problems[0]


def test_operators_save_choose_and_remove(studio: Any, folder: Path) -> None:
    """Save the active clay's material, use it for other clay, and keep the values on removal."""
    first, second = studio.clay("First"), studio.clay("Second", location=(0.1, 0.0, 0.03))
    studio.select(first)
    assert not bpy.ops.clay.material_remove.poll()
    first.tactile_clay.yield_stress = 4321.0
    assert first.tactile_clay.material_preset == "CUSTOM"
    assert bpy.ops.clay.material_save(label="Mine") == {"FINISHED"}
    assert first.tactile_clay.material_preset == "mine"
    second.tactile_clay.material_preset = "mine"
    assert second.tactile_clay.yield_stress == 4321.0
    studio.scene.tactile_clay.material_preset = "mine"
    third = studio.clay("Third", location=(0.2, 0.0, 0.03))
    assert (third.tactile_clay.material_preset, third.tactile_clay.yield_stress) == ("mine", 4321.0)
    studio.select(studio.block(location=(0.3, 0.0, 0.03)))
    assert bpy.ops.clay.make(spacing=0.01, material_preset="mine") == {"FINISHED"}
    assert bpy.context.object.tactile_clay.yield_stress == 4321.0

    studio.select(first)
    assert bpy.ops.clay.material_remove() == {"FINISHED"}
    assert list(folder.iterdir()) == []
    for clay in (first, second, third):
        assert clay.tactile_clay.material_preset == "CUSTOM"
        assert clay.tactile_clay.yield_stress == 4321.0
    assert studio.scene.tactile_clay.material_preset == "plasticine"
    with pytest.raises(UserMaterialError, match="not one of your materials"):
        remove_user_material("plasticine")


def test_save_operator_reports_what_is_wrong(studio: Any, folder: Path) -> None:
    """Report the error's message; unavailable unless clay is active."""
    studio.select(studio.clay())
    assert "comes with the extension" in studio.refused(bpy.ops.clay.material_save, label="Wax")
    studio.select(studio.block(location=(0.1, 0.0, 0.03)))
    assert not bpy.ops.clay.material_save.poll()


def test_missing_preset_keeps_its_values(studio: Any, folder: Path, tmp_path: Path) -> None:
    """Mark a preset that this machine lacks as missing, and keep the clay's values."""
    clay = studio.clay()
    studio.select(clay)
    clay.tactile_clay.yield_stress = 4321.0
    bpy.ops.clay.material_save(label="Mine")
    studio.scene.tactile_clay.material_preset = "mine"
    path = studio.save(tmp_path)
    (folder / "mine.toml").unlink()
    user_materials.forget_user_materials()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    values = bpy.context.scene.objects["Clay"].tactile_clay
    assert values.material_preset == f"MISSING_{material_number('mine')}"
    assert values.yield_stress == 4321.0
    message = studio.refused(bpy.ops.clay.make, spacing=0.01)
    assert "not on this machine" in message
    values.friction = 0.25
    assert values.material_preset == "CUSTOM"


def test_preset_numbers_stay_stable(studio: Any) -> None:
    """Keep the numbers that .blend files of earlier versions store for the presets."""
    assert material_number("plasticine") == 16241818
    assert {item[0]: item[4] for item in material_presets.SHIPPED_ITEMS} == {
        name: material_number(name) for name in Material.preset_names()
    }
    assert studio.clay().tactile_clay.material_preset == "plasticine"


WITH_HOME = """
import os, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
import tactile_clay
tactile_clay.register()
from tactile_clay.clay_addon.model.user_materials import save_user_material, user_material_folder
from tactile_clay.solver import Material
save_user_material("Mine", Material())
print(user_material_folder())
tactile_clay.unregister()
sys.stdout.flush()
os._exit(0)
"""


def test_folder_is_in_blenders_user_folder(tmp_path: Path) -> None:
    """Save among Blender's user files, even if the add-on is not installed as an extension."""
    result = subprocess.run(
        [sys.executable, "-c", WITH_HOME],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path)},
    )
    assert result.returncode == 0, result.stderr
    folder = Path(result.stdout.strip().splitlines()[-1])
    assert folder.is_relative_to(tmp_path)
    assert (folder / "mine.toml").is_file()
