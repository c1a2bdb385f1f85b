# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials and their presets."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.solver import Material


def test_every_preset_reads_and_names_its_source():
    """Read each preset that ships; each has a label, and a source for every one of its values."""
    import tomllib

    names = Material.preset_names()
    assert names == [
        "plasticine", "soft_play_dough", "stiff_clay", "throwing_clay", "wax", "wet_clay",
    ]  # fmt: skip
    folder = Path(__file__).resolve().parents[3] / "presets" / "materials"
    for name in names:
        material = Material.preset(name)
        table = tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))
        assert table["label"]
        assert table["description"]
        values = {"density", "yield_stress", "viscosity", "shear_modulus", "friction"}
        assert set(table["material"]) == set(table["source"]) == values
        assert all(len(text) > 20 for text in table["source"].values())
        assert all(getattr(material, key) == table["material"][key] for key in values)


def test_unknown_preset_lists_those_available():
    """List the presets in the error about an unknown one."""
    with pytest.raises(ValueError, match="plasticine"):
        Material.preset("marzipan")


def test_preset_name_cannot_leave_the_folder():
    """Refuse a name that is a path."""
    with pytest.raises(ValueError, match="no material preset"):
        Material.preset("../materials/plasticine")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0])
@pytest.mark.parametrize("name", ["density", "yield_stress", "viscosity", "shear_modulus"])
def test_bad_value_is_refused_by_name(name: str, value: float):
    """Name the value that is wrong."""
    with pytest.raises(ValueError, match=name):
        Material(**{name: value})


@given(text=st.text(max_size=200))
def test_any_text_is_read_or_refused(tmp_path_factory, text: str):
    """Fail on a preset file only with a clear ValueError."""
    path = tmp_path_factory.mktemp("presets") / "any.toml"
    path.write_text(text, encoding="utf-8")
    try:
        Material.from_toml(path)
    except ValueError as error:
        assert "any.toml" in str(error) or "Material." in str(error)


def test_unknown_key_and_text_value_are_refused(tmp_path: Path):
    """Name an unknown key, and a value that is not a number."""
    path = tmp_path / "odd.toml"
    path.write_text("[material]\nstickiness = 1.0\n")
    with pytest.raises(ValueError, match="stickiness"):
        Material.from_toml(path)
    path.write_text('[material]\ndensity = "heavy"\n')
    with pytest.raises(ValueError, match="density"):
        Material.from_toml(path)
