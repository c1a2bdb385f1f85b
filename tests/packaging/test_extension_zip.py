# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's zip contains the files needed at run time and nothing else."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

PARTS = ("clay_addon", "haptics", "presets", "solver")
SINGLE_FILES = {"LICENSE", "README.md", "__init__.py", "blender_manifest.toml"}


def product_files(repository: Path) -> set[str]:
    """The files that belong in the zip besides the wheels."""
    return SINGLE_FILES | {
        path.relative_to(repository).as_posix()
        for part in PARTS
        for path in (repository / part).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")
    }


def test_zip_contains_exactly_the_product(
    repository: Path, extension_zip_without_wheels: Path
) -> None:
    """The zip contains no tests, tools, caches or development files."""
    with zipfile.ZipFile(extension_zip_without_wheels) as archive:
        assert set(archive.namelist()) == product_files(repository)


def test_zip_with_wheels_has_the_wheels_of_one_platform(
    repository: Path, request: pytest.FixtureRequest
) -> None:
    """The zip contains, and its manifest lists, only the six wheels of this platform."""
    if not list((repository / "wheels").glob("warp_lang-*.whl")):
        pytest.skip("needs the wheels: run `make extension` once")
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
    """The message names the unknown platform and lists the others."""
    command = [sys.executable, str(repository / "tools" / "extension.py")]
    command += ["--platforms", "amiga-m68k", "--output", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "amiga-m68k" in result.stderr
    assert "linux-x64" in result.stderr
    assert list(tmp_path.iterdir()) == []
