# SPDX-License-Identifier: GPL-3.0-or-later
"""The field and the drives against other packages, each in a separate environment.

``make acoustic-peers`` creates the environments and runs these tests; otherwise they are skipped.
"""

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactile_clay.haptics import TransducerArray, acoustic_field, drive_steps, solve_drive
from tactile_clay.haptics.acoustics.acoustic_field import propagation
from tactile_clay.tests.haptics.peers.environments import PEERS, ready
from tactile_clay.tests.haptics.target_sets import Targets, random_targets

FOLDER = Path(__file__).resolve().parent


def run_peer(name: str, repository: Path, folder: Path, **scene: Any) -> dict[str, np.ndarray]:
    """Run a peer's script on arrays, and return its results."""
    python = ready(PEERS[name], repository)
    if python is None:
        pytest.skip(f"{name} is not installed in build/peers: `make acoustic-peers` does it")
    told, answer = folder / "scene.npz", folder / "result.npz"
    np.savez(told, **scene)
    done = subprocess.run(
        (str(python), str(FOLDER / PEERS[name].script), str(told), str(answer)),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(np.load(answer))


def test_field_is_levitates(repository: Path, tmp_path: Path) -> None:
    """Match levitate's pressure of each of 256 transducers at points all around, to 1e-4."""
    random = np.random.default_rng(0)
    points = random.uniform((-0.1, -0.1, 0.03), (0.1, 0.1, 0.3), (200, 3))
    found = run_peer(
        "levitate", repository, tmp_path, points=points, p0=6.0, radius=0.0045, columns=16,
        pitch=0.0105,
    )  # fmt: skip
    array = TransducerArray.grid(
        16, 16, 0.0105, p0=6.0, radius=0.0045, speed_of_sound=float(found["speed_of_sound"])
    )
    order = np.lexsort(np.rint(found["positions"] * 1e5).T[[0, 1]])
    assert np.allclose(found["positions"][order], array.positions, atol=1e-9)
    theirs, ours = found["transfer"][:, order], propagation(array, points)
    error = np.abs(ours - theirs).max() / np.abs(theirs).max()
    print(f"levitate: field differs by {error:.1e} of the largest pressure")
    assert error < 1e-4
    assert np.abs(ours / theirs - 1.0)[np.abs(theirs) > 1.0].max() < 1e-4


@pytest.fixture(scope="module")
def sphere() -> TransducerArray:
    """AUTD3 as in its emulator, without directivity."""
    return replace(TransducerArray.preset("autd3"), radius=0.0)


@pytest.fixture(scope="module")
def targets() -> list[Targets]:
    """The targets for both solvers."""
    return random_targets(100)


@pytest.fixture(scope="module")
def autd3(
    sphere: TransducerArray,
    targets: list[Targets],
    repository: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, np.ndarray]:
    """autd3's results for the targets, and for our drives of the first twelve of them."""
    phases, amplitudes = zip(
        *(drive_steps(sphere, solve_drive(sphere, *t)) for t in targets[:12]), strict=True
    )
    return run_peer(
        "autd3",
        repository,
        tmp_path_factory.mktemp("autd3"),
        speed_of_sound=sphere.speed_of_sound,
        sizes=np.array([len(t[1]) for t in targets]),
        points=np.concatenate([t[0] for t in targets]),
        pressures=np.concatenate([t[1] for t in targets]),
        phases=np.array(phases, np.uint8),
        intensities=np.array(amplitudes, np.uint8),
        probes=np.array([t[0][0] for t in targets[:12]]),
    )


def test_geometry_is_autd3s(sphere: TransducerArray, autd3: dict[str, np.ndarray]) -> None:
    """Match the positions and order of all 249 transducers in autd3."""
    assert np.abs(autd3["positions"] - sphere.positions).max() < 1e-6


def test_autd3s_emulator_hears_what_we_drive(
    sphere: TransducerArray, targets: list[Targets], autd3: dict[str, np.ndarray]
) -> None:
    """Match the pressure of our drives in its emulator, which also reaches the targets."""
    ratios = []
    for (points, pressures), (x, y, z, rms) in zip(targets[:12], autd3["fields"], strict=True):
        drive = solve_drive(sphere, points, pressures)
        expected = abs(acoustic_field(sphere, drive, [(x, y, z)])[0])
        assert np.sqrt(2.0) * rms == pytest.approx(expected, rel=0.02)
        ratios.append(np.sqrt(2.0) * rms / pressures[0])
    print(f"autd3-emulator: achieved/target {np.mean(ratios):.4f} ± {np.std(ratios):.4f}")
    assert np.abs(np.array(ratios) - 1.0).max() < 0.03


def test_drives_are_better_than_autd3s(
    sphere: TransducerArray, targets: list[Targets], autd3: dict[str, np.ndarray]
) -> None:
    """Scatter less around the targets than autd3's GS-PAT, which scatters like ours."""
    spread = {}
    theirs = autd3["intensities"] / 255 * np.exp(2j * np.pi / 256 * autd3["phases"])
    for name in ("autd3", "gspat", "exact"):
        ratios = []
        for index, (points, pressures) in enumerate(targets):
            drive = (
                theirs[index]
                if name == "autd3"
                else solve_drive(sphere, points, pressures, method=name)
            )
            reached = np.abs(acoustic_field(sphere, drive, points)) / pressures
            ratios.append(reached / reached.mean())
        spread[name] = float(np.concatenate(ratios).std())
    milliseconds = 1e3 * float(np.median(autd3["seconds"]))
    print(f"SD of achieved/target: {spread}; autd3 takes {milliseconds:.2f} ms")
    assert spread["exact"] < 0.1 * spread["autd3"]
    assert spread["gspat"] == pytest.approx(spread["autd3"], rel=0.5)
