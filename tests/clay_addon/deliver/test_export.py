# SPDX-License-Identifier: GPL-3.0-or-later
"""Exported meshes, read back by trimesh and by Blender's own importers."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import bpy
import numpy as np
import pytest
import trimesh
from trimesh.exchange.gltf import load_glb

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.core.surface.exact import Surface, reconstruct
from tactile_clay.clay_addon.deliver import export
from tactile_clay.clay_addon.deliver.export import (
    ExportError,
    check_target,
    export_clay,
    write_mesh,
)

RED, BLUE = (0.6, 0.05, 0.01, 1.0), (0.02, 0.2, 0.8, 1.0)
SPACING = 0.005


@pytest.fixture(scope="module")
def surface() -> Surface:
    """A colored slab, three times as wide as high, centered at (0.2, -0.1, 0.3)."""
    axes = [np.arange(count) - (count - 1) / 2 for count in (12, 8, 4)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    colors = np.where(points[:, :1] < 0, RED, BLUE)
    return reconstruct(points * SPACING + [0.2, -0.1, 0.3], SPACING, colors=colors)


def srgb(linear: Any) -> np.ndarray:
    """The sRGB transfer function by its definition."""
    linear = np.asarray(linear, float)
    return np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def read(path: Path) -> trimesh.Trimesh:
    """Read the single mesh of a file, in meters if the file states its unit."""
    if path.suffix == ".3mf":
        return read_3mf(path)
    loaded = trimesh.load(path)
    if isinstance(loaded, trimesh.Scene):
        (loaded,) = loaded.geometry.values()
    return loaded


def read_3mf(path: Path) -> trimesh.Trimesh:
    """Read a 3MF file according to the specification: a mesh in meters, with vertex colors."""
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    material = "{http://schemas.microsoft.com/3dmanufacturing/material/2015/02}"
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        relations = ElementTree.fromstring(archive.read("_rels/.rels"))
        types = archive.read("[Content_Types].xml").decode()
        target = relations[0].attrib["Target"].lstrip("/")
        root = ElementTree.fromstring(archive.read(target))
    assert "application/vnd.ms-package.3dmanufacturing-3dmodel+xml" in types
    assert root.attrib["unit"] == "millimeter"
    (part,) = root.findall(f"{core}resources/{core}object")
    (built,) = root.findall(f"{core}build/{core}item")
    assert built.attrib["objectid"] == part.attrib["id"]
    vertices = [[float(each.attrib[axis]) for axis in "xyz"] for each in part.iter(f"{core}vertex")]
    triangles = list(part.iter(f"{core}triangle"))
    faces = [[int(each.attrib[key]) for key in ("v1", "v2", "v3")] for each in triangles]
    mesh = trimesh.Trimesh(np.array(vertices) / 1000, faces, process=False)
    palette = [
        list(bytes.fromhex(each.attrib["color"][1:])) for each in root.iter(f"{material}color")
    ]
    if palette:
        colors = np.zeros((len(vertices), 4), np.uint8)
        for face, each in zip(faces, triangles, strict=True):
            assert each.attrib["pid"] == "1"
            colors[face] = [palette[int(each.attrib[key])] for key in ("p1", "p2", "p3")]
        mesh.visual.vertex_colors = colors
    return mesh


@pytest.mark.parametrize("suffix", export.SUFFIXES)
def test_file_is_watertight_and_has_the_same_volume(
    suffix: str, surface: Surface, tmp_path: Path
) -> None:
    """Every format is read back watertight, wound outward and within 0.5 % of the volume."""
    path = write_mesh(surface, tmp_path / f"clay{suffix}")
    mesh = read(path)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert len(mesh.faces) == len(surface.faces)
    assert mesh.volume == pytest.approx(12 * 8 * 4 * SPACING**3, rel=0.005)
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", export.SUFFIXES)
def test_axes_are_those_of_blenders_exporters(
    suffix: str, surface: Surface, tmp_path: Path
) -> None:
    """STL, 3MF and PLY keep Z up; OBJ and GLB have Y up."""
    center = read(write_mesh(surface, tmp_path / f"clay{suffix}")).bounds.mean(axis=0)
    expected = (0.2, -0.1, 0.3) if suffix in (".stl", ".3mf", ".ply") else (0.2, 0.3, 0.1)
    np.testing.assert_allclose(center, expected, atol=1e-3)


@pytest.mark.parametrize("suffix", [".3mf", ".obj", ".ply", ".glb"])
def test_colors_are_in_the_formats_own_space(suffix: str, surface: Surface, tmp_path: Path) -> None:
    """3MF, OBJ and PLY have sRGB, GLB linear colors, accurate to 1 % at both ends of the slab."""
    mesh = read(write_mesh(surface, tmp_path / f"clay{suffix}"))
    visual = mesh.visual
    stored = visual.vertex_attributes["color"] if suffix == ".glb" else visual.vertex_colors
    found = np.asarray(stored)[:, :3] / 255
    encode = np.asarray if suffix == ".glb" else srgb
    left, right = mesh.vertices[:, 0] < 0.18, mesh.vertices[:, 0] > 0.22
    np.testing.assert_allclose(found[left].mean(axis=0), encode(RED[:3]), atol=0.01)
    np.testing.assert_allclose(found[right].mean(axis=0), encode(BLUE[:3]), atol=0.01)


def imported(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """World vertices and linear colors as Blender's own importer reads a file."""
    before = set(bpy.data.objects)
    operator = {
        ".stl": lambda: bpy.ops.wm.stl_import(filepath=str(path)),
        ".obj": lambda: bpy.ops.wm.obj_import(filepath=str(path)),
        ".ply": lambda: bpy.ops.wm.ply_import(filepath=str(path)),
        ".glb": lambda: bpy.ops.import_scene.gltf(filepath=str(path)),
    }[path.suffix]
    assert operator() == {"FINISHED"}
    bpy.context.view_layer.update()
    item = next(item for item in set(bpy.data.objects) - before if item.type == "MESH")
    mesh = item.data
    vertices = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", vertices.ravel())
    matrix = np.array(item.matrix_world)
    layer = mesh.color_attributes[0] if len(mesh.color_attributes) else None
    if layer is None:
        return vertices @ matrix[:3, :3].T + matrix[:3, 3], None
    colors = np.empty((len(layer.data), 4), np.float32)
    layer.data.foreach_get("color", colors.ravel())
    if layer.domain == "CORNER":
        corners = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", corners)
        by_vertex = np.empty((len(vertices), 4), np.float32)
        by_vertex[corners] = colors
        colors = by_vertex
    return vertices @ matrix[:3, :3].T + matrix[:3, 3], colors


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".glb"])
def test_blender_imports_the_same_position_and_colors(
    suffix: str, surface: Surface, tmp_path: Path
) -> None:
    """Blender's importers with default settings restore position, size and colors."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices, colors = imported(write_mesh(surface, tmp_path / f"clay{suffix}"))
    np.testing.assert_allclose(vertices.min(axis=0), surface.vertices.min(axis=0), atol=1e-5)
    np.testing.assert_allclose(vertices.max(axis=0), surface.vertices.max(axis=0), atol=1e-5)
    if suffix == ".stl":
        assert colors is None
        return
    assert colors is not None
    left, right = vertices[:, 0] < 0.18, vertices[:, 0] > 0.22
    np.testing.assert_allclose(colors[left].mean(axis=0), RED, atol=0.01)
    np.testing.assert_allclose(colors[right].mean(axis=0), BLUE, atol=0.01)


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_blender_shades_the_surface_smoothly(suffix: str, surface: Surface, tmp_path: Path) -> None:
    """All triangles around a vertex share its normal, which is the surface's own."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    imported(write_mesh(surface, tmp_path / f"clay{suffix}"))
    (item,) = (item for item in bpy.data.objects if item.type == "MESH")
    corners = np.array([loop.vertex_index for loop in item.data.loops])
    local = np.array([corner.vector for corner in item.data.corner_normals])
    world = local @ np.array(item.matrix_world)[:3, :3].T
    np.testing.assert_allclose(world, surface.normals[corners], atol=1e-3)


def test_glb_has_unit_normals_everywhere(surface: Surface, tmp_path: Path) -> None:
    """Even a vertex without faces has a normal of length 1, as glTF requires."""
    extended = Surface(np.vstack([surface.vertices, [[0.2, -0.1, 0.3]]]), surface.faces)
    content = write_mesh(extended, tmp_path / "clay.glb").read_bytes()
    (part,) = load_glb(io.BytesIO(content))["geometry"].values()
    assert len(part["vertex_normals"]) == len(extended.vertices)
    np.testing.assert_allclose(np.linalg.norm(part["vertex_normals"], axis=1), 1, atol=1e-5)


def test_glb_is_not_metallic(surface: Surface, tmp_path: Path) -> None:
    """Colored or not, a GLB file has a rough, non-metallic material."""
    for item in (surface, Surface(surface.vertices, surface.faces)):
        material = read(write_mesh(item, tmp_path / "clay.glb")).visual.material
        assert material.metallicFactor == 0
        assert material.roughnessFactor == pytest.approx(0.6)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_obj_keeps_single_precision_at_any_size(
    size: float, surface: Surface, tmp_path: Path
) -> None:
    """The number of decimals follows the size of the clay."""
    scaled = Surface(surface.vertices * size, surface.faces)
    (low, high) = read(write_mesh(scaled, tmp_path / "clay.obj")).bounds
    expected = np.ptp(scaled.vertices, axis=0)[[0, 2, 1]]
    np.testing.assert_allclose(high - low, expected, rtol=1e-5)


@pytest.mark.parametrize("suffix", export.SUFFIXES)
def test_colorless_surface_is_written(suffix: str, surface: Surface, tmp_path: Path) -> None:
    """A surface without colors gives a file without colors."""
    mesh = read(write_mesh(Surface(surface.vertices, surface.faces), tmp_path / f"clay{suffix}"))
    assert mesh.is_watertight
    assert mesh.visual.kind != "vertex"


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_millimeters_are_a_thousand_times_larger(
    suffix: str, surface: Surface, tmp_path: Path
) -> None:
    """The unit scales the numbers in the file."""
    path = write_mesh(surface, tmp_path / f"clay{suffix}", unit="mm")
    assert read(path).volume == pytest.approx(surface.volume * 1e9, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "unit", "message"),
    [
        ("clay.fbx", "m", r"'\.fbx'.*\.stl, \.3mf, \.obj, \.ply, \.glb"),
        ("clay", "m", "without a suffix"),
        ("clay.stl", "inch", "m, mm"),
        ("clay.glb", "mm", "always in meters"),
        ("nowhere/clay.stl", "m", "does not exist"),
        ("folder.stl", "m", "is a folder"),
    ],
)
def test_impossible_targets_are_refused(
    name: str, unit: str, message: str, surface: Surface, tmp_path: Path
) -> None:
    """A target that cannot be written is refused before any work, and no file is left."""
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(ExportError, match=message):
        check_target(tmp_path / name, unit=unit)
    with pytest.raises(ExportError, match=message):
        write_mesh(surface, tmp_path / name, unit=unit)
    assert [item.name for item in tmp_path.iterdir()] == ["folder.stl"]


def test_suffix_may_be_upper_case(surface: Surface, tmp_path: Path) -> None:
    """CLAY.STL is an STL file."""
    assert read(write_mesh(surface, tmp_path / "CLAY.STL")).is_watertight


@pytest.mark.parametrize(
    ("code", "message"), [(errno.ENOSPC, "disk is full"), (errno.EACCES, "Choose another folder")]
)
def test_failed_write_keeps_the_existing_file(
    code: int, message: str, surface: Surface, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If writing fails midway, the old file is intact and no other is left."""
    path = tmp_path / "clay.ply"
    path.write_bytes(b"old")

    def fail(handle: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ExportError, match=message):
        write_mesh(surface, path)
    assert path.read_bytes() == b"old"
    assert [item.name for item in tmp_path.iterdir()] == ["clay.ply"]


def test_clay_too_far_from_the_origin_is_refused(surface: Surface, tmp_path: Path) -> None:
    """If single precision would collapse triangles, nothing is written."""
    far = Surface(surface.vertices + 1e5, surface.faces)
    with pytest.raises(ExportError, match="closer to the origin"):
        write_mesh(far, tmp_path / "clay.stl")
    assert not list(tmp_path.iterdir())


def test_formats_need_only_numpy(tmp_path: Path) -> None:
    """No format needs scipy, networkx or Pillow, which Blender lacks, or is slow without them."""
    source = f"""
import logging, os, sys
sys.modules.update(dict.fromkeys(["scipy", "networkx", "PIL"]))
logging.basicConfig()
import numpy as np
from tactile_clay.clay_addon.deliver.export import SUFFIXES, write_mesh
from tactile_clay.clay_addon.core.surface.exact import Surface

vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
surface = Surface(vertices, faces, np.full((4, 4), 0.5, np.float32))
for suffix in SUFFIXES:
    print(write_mesh(surface, {str(tmp_path)!r} + "/clay" + suffix))
# Do not wait for Blender's own threads.
sys.stdout.flush()
os._exit(0)
"""
    result = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert "WARNING:trimesh" not in result.stderr
    for suffix in export.SUFFIXES:
        assert read(tmp_path / f"clay{suffix}").is_watertight


# The operator and the scene -----------------------------------------------------------------


def test_clay_is_exported_in_world_space(studio: Any, tmp_path: Path) -> None:
    """Location, rotation and scale of the object are applied; the result describes the file."""
    clay = studio.clay(location=(0.0, 0.0, 0.0))
    clay.location = (1.0, 2.0, 3.0)
    clay.rotation_euler = (0.3, 0.2, 0.1)
    clay.scale = (1.5, 1.5, 1.5)
    bpy.context.view_layer.update()
    result = export_clay(bpy.context, tmp_path / "clay.stl")
    mesh = read(tmp_path / "clay.stl")
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), (1, 2, 3), atol=2e-3)
    assert mesh.volume == pytest.approx(64 * 0.015**3, rel=0.005)
    assert result["particles"] == 64
    assert result["faces"] == len(mesh.faces)
    assert result["volume"] == pytest.approx(mesh.volume, rel=1e-3)
    assert abs(result["volume_error"]) < 0.003
    assert result["watertight"] is True
    assert result["file"] == str(tmp_path / "clay.stl")


def test_scene_unit_is_respected(studio: Any, tmp_path: Path) -> None:
    """In a scene in centimeters, a file in meters is a hundredth of the size."""
    studio.clay()
    before = export_clay(bpy.context, tmp_path / "clay.stl")["volume"]
    studio.scene.unit_settings.scale_length = 0.01
    after = export_clay(bpy.context, tmp_path / "clay.stl")["volume"]
    assert after == pytest.approx(before * 1e-6, rel=1e-3)


def test_operator_exports_all_or_selected(studio: Any, tmp_path: Path) -> None:
    """All clay, or only the selected objects, is exported to one file."""
    studio.clay("First")
    second = studio.clay("Second", location=(0.2, 0.0, 0.03))
    path = tmp_path / "clay.ply"
    assert bpy.ops.clay.export(filepath=str(path)) == {"FINISHED"}
    assert read(path).volume == pytest.approx(128e-6, rel=0.005)
    studio.select(second)
    assert bpy.ops.clay.export(filepath=str(path), use_selection=True) == {"FINISHED"}
    mesh = read(path)
    assert mesh.volume == pytest.approx(64e-6, rel=0.005)
    assert mesh.bounds.mean(axis=0)[0] == pytest.approx(0.2, abs=0.002)


def test_operator_reports_errors(studio: Any, tmp_path: Path) -> None:
    """An unknown suffix, an empty selection and particles that are not finite are reported."""
    clay = studio.clay()
    assert ".stl, .3mf, .obj, .ply, .glb" in studio.refused(
        bpy.ops.clay.export, filepath=str(tmp_path / "clay.abc")
    )
    studio.select()
    assert "No clay is selected" in studio.refused(
        bpy.ops.clay.export, filepath=str(tmp_path / "clay.stl"), use_selection=True
    )
    clay.data.attributes["position"].data[3].vector = (float("nan"), 0, 0)
    assert "1 of 64 particles" in studio.refused(
        bpy.ops.clay.export, filepath=str(tmp_path / "clay.stl")
    )
    assert not list(tmp_path.iterdir())


def test_operator_needs_clay(studio: Any, tmp_path: Path) -> None:
    """Without clay, the operator is grayed out and the function raises an error."""
    assert not bpy.ops.clay.export.poll()
    with pytest.raises(ExportError, match="no clay"):
        export_clay(bpy.context, tmp_path / "clay.stl")
    with pytest.raises(ExportError, match="'Cube' is a mesh"):
        export_clay(bpy.context, tmp_path / "clay.stl", objects=[studio.block()])


@pytest.mark.parametrize("name", ["pysplashsurf", "trimesh"])
def test_missing_library_is_reported(
    name: str, studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message says what to install, and nothing is written."""
    studio.clay()
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ExportError, match=f"{name} is missing"):
        export_clay(bpy.context, tmp_path / "clay.stl")
    assert not list(tmp_path.iterdir())


def test_operator_warns_if_the_frame_is_not_shown(
    studio: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The shape shown is exported, with a warning that it is not the baked frame."""
    studio.falling_block(tmp_path, end=2)
    cache = Cache(bake(bpy.context).directory)
    cache.frame_path(2).write_bytes(b"")
    studio.scene.frame_set(2)
    capfd.readouterr()
    assert bpy.ops.clay.export(filepath=str(tmp_path / "clay.stl")) == {"FINISHED"}
    assert "Warning: Frame 2: frame_000002.npz is damaged" in capfd.readouterr().out


def test_read_only_file_system_is_reported(
    surface: Surface, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error is reported even if the temporary file cannot be removed."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(ExportError, match="Read-only file system"):
        write_mesh(surface, tmp_path / "clay.stl")


MEMORY = """
import os, resource, sys
import bpy
import numpy as np
from tactile_clay.clay_addon.deliver.export import _print_table, write_mesh
from tactile_clay.clay_addon.core.surface.exact import reconstruct
import trimesh

def peak():
    # In kilobytes, on macOS in bytes.
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit

side = 21
points = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3) * 0.002
points += np.random.default_rng(0).normal(0, 0.0002, points.shape)
colors = np.random.default_rng(1).uniform(0, 1, (len(points), 4)).astype(np.float32)
reconstruct(points[:100], 0.002, colors=colors[:100])
before = peak()
surface = reconstruct(points, 0.002, colors=colors)
for suffix in (".stl", ".3mf", ".obj", ".ply", ".glb"):
    write_mesh(surface, os.path.join(sys.argv[-1], "clay" + suffix))
_print_table(surface, 1.0)
print(len(points), peak() - before)
sys.stdout.flush()
os._exit(0)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs the resource module")
def test_memory_is_proportional_to_particles(tmp_path: Path) -> None:
    """Export to all formats with checks and random colors peaks below 5 kB per particle."""
    result = subprocess.run(
        [sys.executable, "-c", MEMORY, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    count, growth = (int(word) for word in result.stdout.split()[-2:])
    assert growth / count < 5000
