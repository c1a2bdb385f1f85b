# SPDX-License-Identifier: GPL-3.0-or-later
"""The ablation reproduces the paper's figure 2."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tactile_clay.tests.experiments import ablation_picture
from tactile_clay.tests.experiments.ablation import (
    SPACING,
    VARIANTS,
    creep_between,
    drop_on_incline,
    piece_sizes,
)
from tactile_clay.tests.experiments.ablation_picture import TIMES, draw_ablation
from tactile_clay.tests.experiments.shapes import block, turned


@pytest.fixture(scope="module")
def results() -> dict:
    """Results of all four variants."""
    return {variant: drop_on_incline(variant, times=TIMES) for variant in VARIANTS}


def test_full_model_flattens_and_holds(results: dict):
    """Absorb the fall by deforming, stay in one piece and then not move at all."""
    full = results["full"]
    assert full.pieces == 1
    assert 0.3 < full.height < 0.8
    assert full.slide < 1e-3 * SPACING
    assert full.creep < 1e-3 * SPACING


def test_without_viscosity_it_fractures(results: dict):
    """Break into pieces, while all others stay whole."""
    assert results["without viscosity"].largest_piece < 0.85
    assert results["without viscosity"].pieces > 30
    assert all(r.pieces == 1 for name, r in results.items() if name != "without viscosity")


def test_without_elastoplasticity_it_drifts(results: dict):
    """Keep creeping, and end flatter than the full model."""
    drifting = results["without elastoplasticity"]
    others = [r.creep for r in results.values() if r is not drifting]
    assert drifting.creep > 0.1 * SPACING
    assert drifting.creep > 5 * max(others)
    assert drifting.height < 0.7 * results["full"].height


def test_without_friction_it_slides(results: dict):
    """Slide downhill far faster than all others move."""
    sliding = results["without friction"]
    others = [r.slide for r in results.values() if r is not sliding]
    assert sliding.slide > 1.0
    assert sliding.slide > 100 * max(others)


def test_picture_shows_four_variants(
    results: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Draw the variants side by side, each in its color."""
    monkeypatch.setattr(ablation_picture, "PANEL", (176, 132))
    path = tmp_path / "ablation.png"
    draw_ablation(list(results.values()), path)
    pixels = np.asarray(Image.open(path)).astype(int)
    quarters = np.array_split(pixels[80:], 4, axis=1)
    green, red, blue, magenta = (q.reshape(-1, 3).T for q in quarters)
    assert ((green[1] > green[0] + 40) & (green[1] > green[2] + 40)).mean() > 0.01
    assert ((red[0] > red[1] + 40) & (red[0] > red[2] + 40)).mean() > 0.01
    assert ((blue[2] > blue[0] + 40) & (blue[2] > blue[1] + 40)).mean() > 0.01
    assert ((magenta[0] > magenta[1] + 40) & (magenta[2] > magenta[1] + 20)).mean() > 0.01


def test_pieces_are_counted():
    """Distinguish a split block from a whole one."""
    points = block(4, SPACING)
    assert list(piece_sizes(points, 1.5 * SPACING)) == [64]
    points[points[:, 0] > 0] += (SPACING, 0, 0)
    assert sorted(piece_sizes(points, 1.5 * SPACING)) == [32, 32]


def test_creep_excludes_rigid_motion():
    """Measure no creep in a rotated and translated block, and the whole of a stretch."""
    points = block(4, SPACING)
    moved = turned(points, 0.7) + np.array((1.0, 2.0, 3.0))
    assert creep_between(points, moved) < 1e-12
    stretched = points * (1.0, 1.0, 1.2)
    expected = 0.2 * np.std(points[:, 2])
    assert creep_between(points, stretched) == pytest.approx(expected, rel=0.05)
