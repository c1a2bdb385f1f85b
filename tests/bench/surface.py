# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of the clay's surface in live sculpting, and its error."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from tactile_clay.tests.experiments.live_surface import SIZES, SurfaceFigures, measure_surface


def measure_all() -> list[SurfaceFigures]:
    """Measure every size."""
    return [measure_surface(size) for size in SIZES]


def figures(result: SurfaceFigures) -> dict[str, Any]:
    """The entry in bench.json."""
    return {"case": f"surface-{result.size}", **asdict(result)}


def sentence(result: SurfaceFigures) -> str:
    """One line about a size."""
    written = "" if result.write_ms is None else f", {result.write_ms:.1f} ms into Blender"
    return (
        f"{'surface-' + result.size:>12}  {result.particles:>9,} particles  "
        f"{result.ms_median:8.1f} ms per surface (p90 {result.ms_p90:.1f}; still "
        f"{result.still_ms:.2f}{written})  {result.core_ms:8.1f} core-ms  "
        f"ball {result.ball_volume - 1:+.1%}, {result.ball_distance:.3f} d off  "
        f"block {result.block_volume - 1:+.1%}, {result.block_distance:.3f} d off"
    )
