# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own tool installs and updates the extension from the index beside the zips."""

import hashlib
import json
import shutil
import sys
import tomllib
from pathlib import Path

import bpy

from tactile_clay.tests.extension_repository import (
    OLD_FILE,
    OLD_VERSION,
    make_older,
    run_tool,
    serve,
)


def current_version(repository: Path) -> str:
    """The version of these sources."""
    manifest = tomllib.loads((repository / "blender_manifest.toml").read_text("utf-8"))
    return str(manifest["version"])


def test_index_lists_each_zip(repository: Path, extension_zip_without_wheels: Path) -> None:
    """The zip is listed with a relative URL, its size, checksum, version and Blender version."""
    folder = extension_zip_without_wheels.parent
    (entry,) = json.loads((folder / "index.json").read_text("utf-8"))["data"]
    content = extension_zip_without_wheels.read_bytes()
    assert entry["archive_url"] == f"./{extension_zip_without_wheels.name}"
    assert entry["archive_size"] == len(content)
    assert entry["archive_hash"] == f"sha256:{hashlib.sha256(content).hexdigest()}"
    assert (entry["version"], entry["blender_version_min"]) == (
        current_version(repository),
        "4.5.0",
    )
    assert extension_zip_without_wheels.name in (folder / "index.html").read_text("utf-8")
    assert sorted(path.name for path in folder.iterdir()) == [
        "index.html",
        "index.json",
        extension_zip_without_wheels.name,
    ]


def test_extension_is_updated_from_the_index(
    repository: Path, extension_zip_without_wheels: Path, tmp_path: Path
) -> None:
    """Installing this version over an older one leaves no old files."""
    (served := tmp_path / "served").mkdir()
    local = tmp_path / "local"
    installed = local / "tactile_clay"
    old = make_older(extension_zip_without_wheels, current_version(repository), served)

    with serve(served) as url:
        common = ("--local-dir", str(local), "--remote-url", url)
        blender = ".".join(str(number) for number in bpy.app.version)
        python = ".".join(str(number) for number in sys.version_info[:3])
        versions = ("--blender-version", blender, "--python-version", python)
        run_tool("sync", *common)
        run_tool("install", "tactile_clay", *common, *versions)
        manifest = tomllib.loads((installed / "blender_manifest.toml").read_text("utf-8"))
        assert manifest["version"] == OLD_VERSION
        assert (installed / OLD_FILE).exists()

        old.unlink()
        for path in extension_zip_without_wheels.parent.iterdir():
            shutil.copy(path, served)
        run_tool("sync", *common)
        run_tool("install", "tactile_clay", *common, *versions)
        manifest = tomllib.loads((installed / "blender_manifest.toml").read_text("utf-8"))
        assert manifest["version"] == current_version(repository)
        assert not (installed / OLD_FILE).exists()
        run_tool("uninstall", "tactile_clay", "--local-dir", str(local))
        assert not installed.exists()
