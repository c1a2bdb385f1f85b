# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels compile for CUDA, checked without a GPU."""

from importlib import import_module
from pathlib import Path

import pytest
import warp as wp

SOLVER = Path(__file__).resolve().parents[2] / "solver"
WITH_KERNELS = sorted(
    ".".join(path.relative_to(SOLVER).with_suffix("").parts)
    for path in SOLVER.rglob("*.py")
    if "@wp.kernel" in path.read_text(encoding="utf-8") and not path.stem.endswith("_cpu")
)


def test_there_are_kernels():
    """Find the modules that hold kernels."""
    assert {
        "contact.law",
        "plastic_bonds.pairs.neighbors",
        "plastic_bonds.pairs.forces",
        "core.particles",
    } <= set(WITH_KERNELS)


@pytest.mark.parametrize("name", WITH_KERNELS)
def test_module_compiles_to_ptx(name: str, tmp_path: Path):
    """Compile every kernel of a module to PTX without a GPU."""
    module = import_module(f"tactile_clay.solver.{name}")
    wp.compile_aot_module(module, arch=86, module_dir=tmp_path, use_ptx=True)
    compiled = list(tmp_path.glob("*.ptx"))
    assert compiled
    text = compiled[0].read_text()
    kernels = [value for value in vars(module).values() if isinstance(value, wp.Kernel)]
    own = [kernel for kernel in kernels if kernel.module.name.endswith(f".{name}")]
    assert own
    for kernel in own:
        assert f".entry {kernel.key}" in text or kernel.key in text
