# SPDX-License-Identifier: GPL-3.0-or-later
"""Dependencies that importing a part of the package must not load."""

import subprocess
import sys

import pytest

BLOCK = """
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError("blocked: " + name, name=name)

sys.meta_path.insert(0, Block())
"""
BLENDER_MODULES = {"bl_ext", "bmesh", "bpy", "bpy_extras", "gpu", "gpu_extras", "mathutils"}


def run_python(source: str) -> subprocess.CompletedProcess[str]:
    """Run source in a new interpreter that exits without waiting for Blender's threads."""
    ending = "\nimport os, sys\nsys.stdout.flush()\nos._exit(0)\n"
    return subprocess.run(
        [sys.executable, "-c", source + ending], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", ["solver", "haptics"])
def test_part_imports_without_blender(name: str) -> None:
    """The solver and haptics can be imported without Blender."""
    result = run_python(BLOCK.format(names=BLENDER_MODULES) + f"import tactile_clay.{name}")
    assert result.returncode == 0, result.stderr


def test_block_hides_blender() -> None:
    """The block really hides bpy, which the test above relies on."""
    result = run_python(BLOCK.format(names=BLENDER_MODULES) + "import bpy")
    assert result.returncode != 0
    assert "blocked: bpy" in result.stderr


def test_addon_registers_without_importing_warp() -> None:
    """Importing, registering and unregistering the add-on, twice, does not load Warp."""
    result = run_python(
        "import sys, bpy, tactile_clay\n"
        "for _ in range(2):\n"
        "    tactile_clay.register()\n"
        "    tactile_clay.unregister()\n"
        "print('warp loaded:', any(name.partition('.')[0] == 'warp' for name in sys.modules))"
    )
    assert result.returncode == 0, result.stderr
    assert "warp loaded: False" in result.stdout


def test_addon_registers_without_packages_for_arrays() -> None:
    """The add-on registers without the packages for ultrasound arrays, and without haptics."""
    result = run_python(
        BLOCK.format(names={"serial", "usb", "autd3", "libusb_package"})
        + "import bpy, tactile_clay\n"
        "tactile_clay.register()\n"
        "tactile_clay.unregister()\n"
        "print('haptics loaded:', 'tactile_clay.haptics' in sys.modules)"
    )
    assert result.returncode == 0, result.stderr
    assert "haptics loaded: False" in result.stdout


def test_addon_registers_without_bundled_packages() -> None:
    """The add-on registers and unregisters in a broken installation without its wheels."""
    result = run_python(
        BLOCK.format(names={"warp", "pysplashsurf", "trimesh"})
        + "import bpy, tactile_clay\ntactile_clay.register()\ntactile_clay.unregister()"
    )
    assert result.returncode == 0, result.stderr
