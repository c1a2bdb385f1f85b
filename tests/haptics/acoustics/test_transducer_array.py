# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays: presets, grids, poses, and invalid values."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.haptics import TransducerArray

PRESETS = ("autd3", "openmpd", "sonicsurface", "stratos_explore", "ultraino")


def test_unknown_preset_lists_the_known_ones():
    """Ship five arrays, and list them when an unknown one is requested."""
    assert tuple(TransducerArray.preset_names()) == PRESETS
    with pytest.raises(ValueError, match="sonicsurface"):
        TransducerArray.preset("sonic_surface")


@pytest.mark.parametrize(
    ("name", "count", "width", "phases", "amplitudes"),
    [
        ("stratos_explore", 256, 15 * 0.0103, None, None),
        ("sonicsurface", 256, 15 * 0.0105, 32, 1),
        ("openmpd", 256, 15 * 0.0105, 128, 64),
        ("autd3", 249, 17 * 0.01016, 256, 255),
        ("ultraino", 64, 7 * 0.0105, 10, 1),
    ],
)
def test_preset_has_its_geometry(name, count, width, phases, amplitudes):
    """Match the device's transducer count, width and steps, centered on the origin."""
    array = TransducerArray.preset(name)
    assert array.count == count
    assert np.ptp(array.positions[:, 0]) == pytest.approx(width)
    assert np.abs(array.positions.min(0) + array.positions.max(0)).max() < 1e-12
    assert (array.phase_steps, array.amplitude_steps) == (phases, amplitudes)
    assert 0.0083 < array.wavelength < 0.0088
    assert (array.normals == (0, 0, 1)).all()


def test_grid_lists_columns_first_and_leaves_gaps():
    """Increase X fastest, then Y, and skip places without a transducer."""
    array = TransducerArray.grid(3, 2, 0.01, missing=[(1, 0)], p0=1.0, radius=0.004)
    expected = [(-1, -0.5), (1, -0.5), (-1, 0.5), (0, 0.5), (1, 0.5)]
    assert np.allclose(array.positions[:, :2], 0.01 * np.array(expected))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
)
def test_placing_is_rigid_and_can_be_undone(turn, shift):
    """Keep distances, rotate normals too, and return to the start."""
    array = TransducerArray.preset("ultraino")
    placed = array.placed(rotation(turn, shift))
    spans = np.linalg.norm(placed.positions - placed.positions[0], axis=1)
    assert np.allclose(spans, np.linalg.norm(array.positions - array.positions[0], axis=1))
    assert np.allclose(placed.positions.mean(0), placed.position, atol=1e-9)
    assert np.allclose(placed.normals, placed.normal, atol=1e-9)
    back = placed.placed(np.eye(4))
    assert np.allclose(back.positions, array.positions, atol=1e-9)


def test_working_volume_moves_with_the_array():
    """Test points in the array's own frame."""
    array = TransducerArray.preset("sonicsurface").placed(rotation((0, np.pi / 2, 0), (1, 0, 0)))
    points = [(1.2, 0, 0), (0.8, 0, 0), (1.2, 0.2, 0), (np.nan, 0, 0)]
    assert array.reaches(points).tolist() == [True, False, False, False]


@pytest.mark.parametrize("matrix", [np.diag((2.0, 2, 2, 1)), np.diag((-1.0, 1, 1, 1)), np.eye(3)])
def test_a_pose_that_is_not_rigid_is_refused(matrix):
    """Say that an array can only be moved and rotated."""
    with pytest.raises(ValueError, match="moved and rotated"):
        TransducerArray.preset("ultraino").placed(matrix)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"p0": 0.0}, "p0"),
        ({"radius": np.nan}, "radius"),
        ({"positions": np.zeros((0, 3))}, "empty"),
        ({"normals": np.array((0.0, 0.0, 2.0))}, "length 1"),
        ({"phase_offsets": np.zeros(3)}, "phase_offsets"),
        ({"phase_steps": 1}, "phase_steps"),
        ({"amplitude_law": "square"}, "amplitude_law"),
        ({"working_volume": np.zeros((2, 3))}, "lowest corner"),
    ],
)
def test_bad_values_are_refused(change, message):
    """Name the invalid value."""
    values = {
        "positions": np.zeros((2, 3)),
        "normals": np.array((0.0, 0.0, 1.0)),
        "p0": 1.0,
        "radius": 0.004,
    }
    with pytest.raises(ValueError, match=message):
        TransducerArray(**(values | change))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not toml", "valid TOML"),
        ("[grid]\ncolumns = 2\nrows = 2\npitch = 0.01", "no \\[array\\]"),
        ("grid = 3\n[array]\np0 = 1.0\nradius = 0.0", "grid is 3; it must be a table"),
        ("[array]\np0 = 1.0\nsize = 3", "unknown key 'size'"),
        ("[array]\np0 = 'loud'", "must be a number"),
        ("[grid]\ncolumns = 2\nrows = 2\npitch = 0.01\n[array]\np0 = 1.0", "radius"),
        ("[grid]\ncolumns = 0\nrows = 2\npitch = 1.0\n[array]\np0 = 1.0\nradius = 0.0", "0 × 2"),
        (
            "[grid]\ncolumns = 2\nrows = 2\npitch = 1.0\nmissing = [[5, 0]]\n[array]\np0 = 1.0",
            "grid",
        ),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, text: str, message: str):
    """Name the file, and say what is wrong with it."""
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        TransducerArray.from_toml(path)
    assert "mine.toml" in str(caught.value)


def test_a_custom_array_is_read(tmp_path: Path):
    """Read individual positions and normals from a file."""
    path = tmp_path / "bowl.toml"
    path.write_text(
        "[array]\npositions = [[0, 0, 0], [0.01, 0, 0]]\nnormals = [[0, 0, 1], [1, 0, 0]]\n"
        "p0 = 2.0\nradius = 0.0045\nphase_offsets = [0.0, 0.5]\n",
        encoding="utf-8",
    )
    array = TransducerArray.from_toml(path)
    assert array.count == 2
    assert array.normals[1].tolist() == [1, 0, 0]
    assert array.phase_offsets.tolist() == [0, 0.5]


def rotation(turn, shift) -> np.ndarray:
    """A pose from angles about the three axes and a shift [m]."""
    pose = np.eye(4)
    for axis, angle in enumerate(turn):
        step = np.eye(4)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        step[first, first] = step[second, second] = np.cos(angle)
        step[first, second], step[second, first] = -np.sin(angle), np.sin(angle)
        pose = step @ pose
    pose[:3, 3] = shift
    return pose


def test_preset_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Open no file for an array that was read before, because live frames need it every time."""
    first = {name: TransducerArray.preset(name) for name in TransducerArray.preset_names()}

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a file was read")

    for method in ("read_text", "open", "glob"):
        monkeypatch.setattr(Path, method, refuse)
    for name, array in first.items():
        assert TransducerArray.preset(name) is array
