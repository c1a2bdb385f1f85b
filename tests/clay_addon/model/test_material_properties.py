# SPDX-License-Identifier: GPL-3.0-or-later
"""Every material value reaches the properties, panel, presets, digests and live sessions."""

from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.model.clay_scene import material_of
from tactile_clay.clay_addon.model.digest import scene_digests
from tactile_clay.clay_addon.model.material_properties import (
    copy_material,
    draw_material,
    property_names,
    read_material,
    write_material,
)
from tactile_clay.clay_addon.sculpt.live.structure import structure
from tactile_clay.solver import Material
from tactile_clay.solver.scene.material import MATERIAL_FIELDS, MaterialField

NAMES = [field.name for field in MATERIAL_FIELDS]


def other_value(field: MaterialField) -> float:
    """A value other than the default, exact in single precision."""
    return 0.75 if field.soft_maximum <= 1.0 else 4096.0


def test_table_matches_the_material() -> None:
    """List each field of a material once, with texts and a range that contains its default."""
    assert [field.name for field in fields(Material)] == NAMES
    for field in MATERIAL_FIELDS:
        assert field.label
        assert field.description
        assert field.minimum < field.soft_maximum
        if field.default is not None:
            assert field.minimum <= field.default <= field.soft_maximum


def test_new_clay_has_the_values_of_a_new_material(studio: Any) -> None:
    """Use the same default in the solver, the properties and the default preset."""
    item = bpy.data.objects.new("plain", None)
    assert read_material(item.tactile_clay) == Material() == Material.preset("plasticine")


values = st.builds(
    Material,
    **{
        field.name: st.none() | st.floats(field.minimum, field.soft_maximum, width=32)
        if field.is_optional
        else st.floats(field.minimum, field.soft_maximum, width=32)
        for field in MATERIAL_FIELDS
        if field.name != "flow_index"
    },
    flow_index=st.sampled_from([0.25, 0.5, 1.0]),
)


@given(material=values)
@settings(max_examples=30, deadline=None)
def test_material_survives_properties_and_files(
    material: Material, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Read back what was written to an object and to a file."""
    import tactile_clay

    tactile_clay.register()
    try:
        item = bpy.data.objects.new("kept", None)
        write_material(item.tactile_clay, material)
        kept = read_material(item.tactile_clay)
        copy = bpy.data.objects.new("copy", None)
        copy_material(item.tactile_clay, copy.tactile_clay)
        assert read_material(copy.tactile_clay) == kept
    finally:
        tactile_clay.unregister()
    assert kept == material
    path = tmp_path_factory.mktemp("materials") / "kept.toml"
    path.write_text(material.to_toml(), encoding="utf-8")
    assert Material.from_toml(path) == material


@pytest.mark.parametrize("field", MATERIAL_FIELDS, ids=NAMES)
def test_changing_any_value_is_detected(studio: Any, field: MaterialField) -> None:
    """Change the digest of a bake and the structure of a session, and set the preset to Custom."""
    clay = studio.clay()
    properties = clay.tactile_clay
    digest, built = scene_digests(studio.scene)["materials"], structure(studio.scene)
    assert properties.material_preset != "CUSTOM"
    write_material(properties, replace(material_of(clay), **{field.name: other_value(field)}))
    assert getattr(material_of(clay), field.name) == other_value(field)
    assert properties.material_preset == "CUSTOM"
    assert scene_digests(studio.scene)["materials"] != digest
    assert structure(studio.scene) != built
    properties.material_preset = "plasticine"
    assert material_of(clay) == Material.preset("plasticine")


def test_panel_draws_each_value(studio: Any) -> None:
    """Show a row for each value, with a switch if it is optional."""
    rows: list[str] = []

    def layout() -> SimpleNamespace:
        return SimpleNamespace(
            column=lambda **_: layout(),
            row=lambda **_: layout(),
            prop=lambda _, name, **__: rows.append(name),
        )

    clay = studio.clay()
    draw_material(layout(), clay.tactile_clay)
    assert rows == list(property_names())


def test_older_file_keeps_its_material(studio: Any, tmp_path: Path) -> None:
    """Read an older .blend, with defaults for values that it lacks."""
    clay = studio.clay()
    write_material(clay.tactile_clay, Material(yield_stress=1234.0, cohesion=77.0, flow_index=0.5))
    stored = clay.tactile_clay
    if hasattr(stored, "bl_system_properties_get"):
        stored = stored.bl_system_properties_get()
    for name in ("flow_index", "use_cohesion", "cohesion"):
        del stored[name]
    studio.save(tmp_path)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    (kept,) = [item for item in bpy.context.scene.objects if item.tactile_clay.role == "CLAY"]
    assert material_of(kept) == Material(yield_stress=1234.0)
