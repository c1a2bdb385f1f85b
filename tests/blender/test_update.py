# SPDX-License-Identifier: GPL-3.0-or-later
"""A real Blender installs the extension from a repository's index, and updates it."""

import shutil
import tomllib
from pathlib import Path
from typing import Any

from tactile_clay.tests.extension_repository import OLD_FILE, OLD_VERSION, make_older, serve

MODULE = "bl_ext.clay_repository.tactile_clay"
CHOOSE = f"""
import bpy
bpy.context.preferences.addons[{MODULE!r}].preferences.device = "cpu"
bpy.ops.wm.save_userpref()
"""
LOOK = f"""
import bpy
import warp
from {MODULE}.clay_addon.base.preferences import ADDON_VERSION
print("FOUND", ADDON_VERSION, bpy.context.preferences.addons[{MODULE!r}].preferences.device)
print("WARP", warp.__file__)
"""


def test_extension_is_updated_by_blender_itself(
    blender: Any, repository: Path, extension_zip: Path, extension_zip_without_wheels: Path
) -> None:
    """Install an older version, update it with wheels and all, and keep what the user chose."""
    version = tomllib.loads((repository / "blender_manifest.toml").read_text("utf-8"))["version"]
    (served := blender.folder / "served").mkdir()
    installed = blender.profile / "extensions" / "clay_repository" / "tactile_clay"

    def extension(*words: str) -> str:
        result = blender.run("--online-mode", "--command", "extension", *words)
        assert result.exit_code == 0, result.output
        assert "Traceback" not in result.output
        assert "Error" not in result.output
        return str(result.output)

    old = make_older(extension_zip_without_wheels, version, served)
    with serve(served) as url:
        extension("repo-add", "clay_repository", "--name", "Clay", "--url", url, "--clear-all")
        extension("install", "--sync", "--enable", "tactile_clay")
        manifest = tomllib.loads((installed / "blender_manifest.toml").read_text("utf-8"))
        assert manifest["version"] == OLD_VERSION
        chosen = blender.run_script(CHOOSE)
        assert chosen.exit_code == 0, chosen.output

        old.unlink()
        for path in extension_zip.parent.iterdir():
            shutil.copy(path, served)
        extension("update", "--sync")

    assert not (installed / OLD_FILE).exists()
    looked = blender.run_script(LOOK)
    assert looked.exit_code == 0, looked.output
    assert f"FOUND {version} cpu" in looked.output
    assert f"WARP {blender.path_inside(blender.profile)}" in looked.output
