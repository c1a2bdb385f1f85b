# SPDX-License-Identifier: GPL-3.0-or-later
"""`pip install .` installs a package that works without a checkout."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

MAKE_SCENE = """
import os, sys
import bpy, tactile_clay
bpy.ops.wm.read_factory_settings(use_empty=True)
tactile_clay.register()
scene = bpy.context.scene
scene.render.fps = 24
scene.frame_start, scene.frame_end = 1, 24
bpy.ops.clay.block_add(size=0.03)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
print("FROM", tactile_clay.__file__)
sys.stdout.flush()
os._exit(0)
"""


def sources(repository: Path, target: Path) -> Path:
    """Copy the sources to a folder, because a build leaves files beside them.

    Returns:
        The folder.
    """
    for item in (
        *("LICENSE", "README.md", "__init__.py", "blender_manifest.toml", "py.typed"),
        *("pyproject.toml", "setup.py", "clay_addon", "haptics", "presets", "solver"),
    ):
        for path in (repository / item, *(repository / item).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                copy = target / path.relative_to(repository)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(path.read_bytes())
    return target


@pytest.fixture(scope="module")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel built from this repository."""
    folder = tmp_path_factory.mktemp("wheel")
    checkout = sources(repository, folder / "checkout")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, str(checkout)], check=True)
    (found,) = folder.glob("*.whl")
    return found


@dataclass(frozen=True)
class Installed:
    """A new environment with the wheel and its dependencies."""

    folder: Path
    """The environment."""

    def run(self, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment outside any checkout."""
        clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        return subprocess.run(
            [str(self.folder / "bin" / program), *arguments],
            cwd=self.folder,
            env=clean,
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installed]:
    """A new environment with the wheel.

    It shares the dependencies of the tests' environment through a .pth file. This does not include
    this repository, which is installed there by an import hook that does not run from a .pth path.
    """
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, with_pip=False, symlinks=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = folder / "lib" / version / "site-packages"
    (site / "shared.pth").write_text(sysconfig.get_path("platlib") + "\n")
    python = folder / "bin" / "python"
    options = ["--quiet", "--no-deps", "--no-index", "--ignore-installed", str(wheel)]
    subprocess.run([str(python), "-m", "pip", "install", *options], check=True)
    yield Installed(folder)


def test_wheel_contains_every_package_and_preset(wheel: Path, repository: Path) -> None:
    """The wheel contains all Python files, presets and the type marker, but no tests."""
    names = set(zipfile.ZipFile(wheel).namelist())
    expected = {"tactile_clay/__init__.py", "tactile_clay/py.typed"}
    for part in ("clay_addon", "haptics", "solver", "presets"):
        expected |= {
            f"tactile_clay/{path.relative_to(repository).as_posix()}"
            for path in (repository / part).rglob("*")
            if path.is_file()
            and "__pycache__" not in path.parts
            and (path.suffix == ".py" or part == "presets")
        }
    assert expected <= names
    assert not {name for name in names if name.startswith("tactile_clay/tests")}


@pytest.mark.skipif(sys.platform == "win32", reason="the folders of an environment differ")
def test_installed_command_works(installed: Installed, tmp_path: Path) -> None:
    """The command of the wheel prints help, bakes a scene and describes it."""
    helped = installed.run("tactile-clay", "--help")
    assert helped.returncode == 0, helped.stderr
    assert "bake" in helped.stdout

    scene = tmp_path / "scene.blend"
    made = installed.run("python", "-c", MAKE_SCENE, str(scene))
    assert made.returncode == 0, made.stderr
    assert f"FROM {installed.folder}" in made.stdout

    baked = installed.run("tactile-clay", "bake", str(scene))
    assert baked.returncode == 0, baked.stderr + baked.stdout
    info = installed.run("tactile-clay", "info", str(scene), "--json")
    assert info.returncode == 0, info.stderr
    bake = json.loads(info.stdout)["bake"]
    assert (bake["frames"], bake["missing"], bake["stale"]) == (24, [], "")
