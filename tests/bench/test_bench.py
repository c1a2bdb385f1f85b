# SPDX-License-Identifier: GPL-3.0-or-later
"""Benchmarks: the cases run, and all engines are measured alike."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from tactile_clay.solver import Settings
from tactile_clay.tests.bench import cases, peers, run, surface, touch
from tactile_clay.tests.bench.peer_scene import DEPTH, MATERIAL, RADIUS, make_scene, measure
from tactile_clay.tests.experiments.live_surface import measure_surface, surface_lines


def test_a_case_is_timed_and_judged():
    """Time a small press, and compare its force with slip-line theory."""
    small = cases.Case("small", "small block", cases.press_ball((6, 6, 6), down=3, along=2))
    figures = run.measure(small, Settings(), "cpu")
    assert figures["particles"] == 216
    assert figures["frames"] == 5
    assert 0.0 < figures["ms_median"] <= figures["ms_p90"]
    assert figures["core_ms"] > 0.0
    assert figures["error"]["measured"] > 1.0
    assert json.loads(json.dumps(figures))["error"]["figure"].startswith("force")
    assert "216 particles" in run.sentence(figures)


@pytest.mark.parametrize("case", touch.CASES, ids=lambda case: case.name)
def test_a_part_of_touch_is_timed_and_judged(case: touch.TouchCase):
    """Time a few frames of each part, with a small error."""
    figures = touch.measure(case, frames=touch.FRAMES if "drive" in case.name else 4)
    assert 0.0 < figures["ms_median"] <= figures["ms_p90"]
    assert figures["core_ms"] > 0.0
    assert figures["error"]["error"] < 0.15
    assert json.loads(json.dumps(figures))["error"]["figure"]
    assert case.name in touch.sentence(figures)


def test_a_surface_is_timed_and_judged():
    """Time surfaces of a block, and find surfaces close to their ball and block."""
    result = measure_surface("2k", frames=2)
    assert result.particles == 2197
    assert 0.0 < result.ms_median <= result.ms_p90
    assert abs(result.ball_volume - 1.0) < 0.03
    assert abs(result.block_volume - 1.0) < 0.03
    assert 0.0 < result.ball_distance < 0.12
    assert 0.0 < result.block_distance < 0.12
    assert json.loads(json.dumps(surface.figures(result)))["case"] == "surface-2k"
    assert "2,197 particles" in surface.sentence(result)
    assert "| 2,197 |" in surface_lines([result])[-1]


def test_error_is_relative_to_the_middle_of_the_range():
    """Be zero inside the range, and outside the distance over its middle."""
    assert cases.Error("force", 13.0, (12.0, 14.0)).error == 0.0
    assert cases.Error("force", 15.3, (12.0, 14.0)).error == pytest.approx(0.1)
    assert cases.Error("compression", 0.02, (0.0, 0.0)).error == pytest.approx(0.02)


def test_the_wheel_carries_as_many_particles_as_the_papers():
    """Make a round dome of 4,169 particles that stands on the wheel."""
    points = cases.dome(cases.WHEEL_COUNT)
    assert len(points) == 4169
    assert np.abs(points[:, :2].mean(0)).max() < 0.1 * cases.SPACING
    assert points[:, 2].min() == pytest.approx(0.5 * cases.SPACING)
    assert points[:, :2].max() < 14.5 * cases.SPACING


def test_an_unknown_case_is_refused():
    """List the cases if an unknown one is requested; skip the largest by default."""
    with pytest.raises(ValueError, match="press-4k"):
        cases.chosen(["press-5k"], everything=False)
    names = {case.name for case in cases.chosen([], everything=False)}
    assert "poke-1m" not in names
    assert "poke-1m" in {case.name for case in cases.chosen([], everything=True)}


def test_measures_of_an_ideal_plastic():
    """Find the whole dent, no spring-back and theory's force for an ideally plastic clay."""
    scene = make_scene(8)
    rest = scene.points
    dented = rest.copy()
    under = np.hypot(rest[:, 0], rest[:, 1]) < 1.1 * scene.spacing
    dented[under & (rest[:, 2] > rest[:, 2].max() - 0.1 * scene.spacing), 2] -= DEPTH
    frames = len(scene.heights)
    force = 5.875 * MATERIAL["yield_stress"] * math.pi * (2 * RADIUS * DEPTH - DEPTH**2)
    result = {
        "positions": np.array([rest, rest, dented, dented]),
        "forces": np.full(frames, force),
        "core_seconds": np.full(frames, 512e-6),
        "wall_seconds": np.full(frames, 1e-3),
    }
    found = measure(scene, result)
    assert found.drift == 0.0
    assert found.force_moving == pytest.approx(1.0)
    assert found.force_held == pytest.approx(1.0)
    assert found.dent == pytest.approx(1.0)
    assert found.spring_back == pytest.approx(0.0)
    assert found.height_lost == 0.0
    assert found.core_microseconds == pytest.approx(1.0)


def test_density_grows_as_volume_shrinks():
    """Measure the right compression, and twice as much for twice the squeeze."""
    scene = make_scene(10)
    frames = np.ones(len(scene.heights))
    changes = []
    for squeeze in (0.01, 0.02):
        after = scene.points * (1.0, 1.0, 1.0 - squeeze)
        result = {
            "positions": np.array([scene.points] * 3 + [after]),
            "forces": frames,
            "core_seconds": frames,
            "wall_seconds": frames,
        }
        with np.errstate(all="ignore"):
            changes.append(measure(scene, result).compression)
    assert changes[0] == pytest.approx(0.01, rel=0.35)
    assert changes[1] / changes[0] == pytest.approx(2.0, rel=0.1)


def test_failures_are_listed_in_the_table(tmp_path: Path):
    """Write why an engine has no results instead of omitting it."""
    broken = peers.Peer("Broken", ("broken",), "no_such_script.py", note="cannot run")
    home = tmp_path / "broken"
    (home / "bin").mkdir(parents=True)
    (home / "bin" / "python").symlink_to(sys.executable)
    (home / "installed.stamp").write_text(f"{sys.version}\nbroken", encoding="utf-8")
    entry = peers.run_peer(broken, make_scene(3), tmp_path)
    assert entry.measures is None
    assert "no_such_script.py" in entry.failure
    peers.write([entry], make_scene(3), tmp_path)
    assert "no_such_script.py" in (tmp_path / "peers.md").read_text("utf-8")
    assert json.loads((tmp_path / "peers.json").read_text("utf-8"))["engines"][0]["failure"]
