# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's zip holds what the product needs at run time and nothing else."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

PARTS = ("clay_addon", "haptics", "presets", "solver")
SINGLE_FILES = {"LICENSE", "README.md", "__init__.py", "blender_manifest.toml"}


def product_files(repository: Path) -> set[str]:
    """List what belongs into the zip beside the wheels."""
    return SINGLE_FILES | {
        path.relative_to(repository).as_posix()
        for part in PARTS
        for path in (repository / part).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")
    }


def test_zip_holds_the_product_and_nothing_else(
    repository: Path, extension_zip_without_wheels: Path
) -> None:
    """Pack every file of the product, and no test, tool, cache or folder of the developer's."""
    with zipfile.ZipFile(extension_zip_without_wheels) as archive:
        assert set(archive.namelist()) == product_files(repository)


def test_zip_with_wheels_holds_the_wheels_of_one_platform(
    repository: Path, request: pytest.FixtureRequest
) -> None:
    """Pack the six wheels of this platform, and name these alone in the manifest."""
    if not list((repository / "wheels").glob("warp_lang-*.whl")):
        pytest.skip("the wheels are not here: run `make extension` once")
    with zipfile.ZipFile(request.getfixturevalue("extension_zip")) as archive:
        names = set(archive.namelist())
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    wheels = {name for name in names if name.startswith("wheels/")}
    assert names - wheels == product_files(repository)
    assert {name.partition("-")[0] for name in wheels} == {
        "wheels/pyserial",
        "wheels/pysplashsurf",
        "wheels/pyusb",
        "wheels/trimesh",
        "wheels/warp_lang",
        "wheels/websockets",
    }
    assert len(wheels) == 6
    assert {f"./{name}" for name in wheels} == set(manifest["build"]["generated"]["wheels"])


def test_unknown_platform_is_refused_by_name(repository: Path, tmp_path: Path) -> None:
    """Say which platforms there are when asked for another."""
    command = [sys.executable, str(repository / "tools" / "extension.py")]
    command += ["--platforms", "amiga-m68k", "--output", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "amiga-m68k" in result.stderr
    assert "linux-x64" in result.stderr
    assert list(tmp_path.iterdir()) == []
