# SPDX-License-Identifier: GPL-3.0-or-later
"""The sculpting tools: sound meshes, clear errors, and that each does to clay what it is for."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_clay.clay_addon.core.tools.presets import (
    PRESET_FOLDER,
    ToolPreset,
    ToolPresetError,
    load_tool_preset,
    tool_preset_names,
)
from tactile_clay.clay_addon.sculpt.tool_stamp import stamp_from_object
from tactile_clay.solver import Material, MeshCollider, Scene, Solver
from tactile_clay.solver.geometry.closed_mesh import mesh_volume
from tactile_clay.tests.experiments.pieces import pieces
from tactile_clay.tests.experiments.shapes import at, block

SPACING = 0.005
RADIUS = 0.012
TOOLS = tool_preset_names()
PRESSING = [name for name in TOOLS if load_tool_preset(name).mode == "press"]
THIN = ["knife", "loop", "wire"]

GOOD = """label = "Peg"
description = "A peg"
mode = "press"
friction = 0.5
size = 1.0
align = "none"
"""


def box_obj(faces: int = 12) -> str:
    """A cube as an OBJ file, with so many of its triangles."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices]
    return "\n".join(lines + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.faces[:faces]])


def test_all_tools_are_there() -> None:
    """List the nine tools; `load_tool_preset` refuses any other by name."""
    expected = {"ball", "finger", "knife", "loop", "paddle", "palm", "rolling_pin", "stamp", "wire"}
    assert set(TOOLS) == expected
    with pytest.raises(ToolPresetError, match=r"no tool preset 'spoon'\. There are: ball, finger"):
        load_tool_preset("spoon")


@pytest.mark.parametrize("name", TOOLS)
def test_mesh_is_closed_small_and_in_its_frame(name: str) -> None:
    """Be one closed body of few triangles, its tip at the origin, its handle up."""
    tool = load_tool_preset(name)
    assert len(tool.faces) < 1500
    assert tool.label
    assert tool.description
    middle = tool.vertices[np.hypot(*tool.vertices[:, :2].T) <= 1.0]
    assert middle[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    assert tool.vertices[:, 2].max() > -tool.vertices[:, 2].min()
    assert mesh_volume(tool.vertices, tool.faces) > 0
    mesh = trimesh.Trimesh(tool.vertices, tool.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 1e-5
    # The loop is the only tool with a hole.
    assert mesh.euler_number == (0 if name == "loop" else 2)


@pytest.mark.parametrize("name", THIN)
@pytest.mark.parametrize("radius", [0.005, 0.012, 0.2])
def test_thin_tools_are_as_thick_as_cutting_needs(name: str, radius: float) -> None:
    """Keep the thin part at least so many spacings thick, whatever the brush radius."""
    tool = load_tool_preset(name)
    fitted = tool.fitted(radius, SPACING)
    mesh = trimesh.Trimesh(fitted, tool.faces, process=False)
    assert mesh.volume > 0
    height = 2.5 * radius if name == "knife" else 0.5 * (fitted[:, 2].min() + fitted[:, 2].max())
    if name == "wire":
        thick = 2.0 * fitted[np.hypot(*tool.vertices[:, :2].T) <= 1.0][:, 1].max()
    elif name == "knife":
        inside = (tool.vertices[:, 2] < 5) & (np.abs(tool.vertices[:, 1]) < 0.5)
        thick = np.ptp(fitted[inside & (fitted[:, 2] < height * 4)][:, 0])
    else:
        low = np.abs(tool.vertices[:, 0]) < 0.1
        thick = np.ptp(fitted[low & (tool.vertices[:, 2] < 0.2)][:, 2])
    expected = max(tool.thickness * SPACING, tool.thinnest * radius)
    assert thick == pytest.approx(expected, rel=0.1)
    middle = np.hypot(*tool.vertices[:, :2].T) <= 1.0
    assert fitted[middle, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_tools_scale_with_the_brush() -> None:
    """Draw a tool as large as brush radius times its size."""
    tool = load_tool_preset("palm")
    assert np.ptp(tool.fitted(0.01, SPACING)[:, 0]) == pytest.approx(2 * 0.01 * tool.size)
    with pytest.raises(ValueError, match=r"radius is 0\.0"):
        tool.fitted(0.0, SPACING)
    with pytest.raises(ValueError, match="spacing is nan"):
        tool.fitted(0.01, float("nan"))


@pytest.mark.parametrize(
    ("toml", "obj", "message"),
    [
        (GOOD, box_obj(11), "peg.obj is open: it has 1 hole"),
        (GOOD, "v 0 0\n", "peg.obj, line 1: a vertex needs three numbers"),
        (GOOD, "v 0 0 x\n", "peg.obj, line 1: could not convert"),
        (GOOD, "v 0 0 0\nf 1 2\n", "line 2: a face needs three"),
        (GOOD, "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        (GOOD, "", "no faces"),
        (GOOD, None, "peg.obj cannot be read"),
        (GOOD + "color = 1\n", box_obj(), "unknown key 'color'"),
        (GOOD.replace('"press"', '"push"'), box_obj(), "mode is 'push'; it must be one of press"),
        (GOOD.replace("size = 1.0", "size = 0.0"), box_obj(), "size is 0.0; it must be"),
        (GOOD.replace("0.5", "nan"), box_obj(), "friction is nan"),
        (GOOD.replace("0.5", '"much"'), box_obj(), "friction is 'much'; it must be a number"),
        (GOOD + "thickness = 1.0\n", box_obj(), "thinnest and thickness go together"),
        (GOOD.replace("label", "name"), box_obj(), "unknown key 'name'"),
        ("label = ", box_obj(), "peg.toml is not a valid TOML file"),
    ],
)
def test_bad_files_say_what_is_wrong(
    tmp_path: Path, toml: str, obj: str | None, message: str
) -> None:
    """Name the file and the fault of a preset that is damaged."""
    (tmp_path / "peg.toml").write_text(toml, encoding="utf-8")
    if obj is not None:
        (tmp_path / "peg.obj").write_text(obj, encoding="utf-8")
    with pytest.raises(ToolPresetError, match=message) as caught:
        load_tool_preset("peg", tmp_path)
    assert "peg." in str(caught.value)


def test_a_folder_of_ones_own_is_read(tmp_path: Path) -> None:
    """Read presets of another folder, with faces of four corners, too."""
    (tmp_path / "peg.toml").write_text(GOOD, encoding="utf-8")
    quads = "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    corners = ["0 0", "1 0", "1 1", "0 1"]
    (tmp_path / "peg.obj").write_text(
        "".join(f"v {xy} {z}\n" for z in (0, 2) for xy in corners) + quads
    )
    tool = load_tool_preset("peg", tmp_path)
    assert tool_preset_names(tmp_path) == ["peg"]
    assert mesh_volume(tool.vertices, tool.faces) == pytest.approx(2.0)


# What they do to clay ---------------------------------------------------------------------------


class Bench:
    """A block of clay on a table, and a tool over it."""

    def __init__(self, name: str, counts: tuple[int, int, int] = (12, 10, 6)) -> None:
        self.tool: ToolPreset = load_tool_preset(name)
        self.top = counts[2] * SPACING
        self.scene = Scene(SPACING)
        self.scene.add_clay(block(counts, SPACING), Material())
        self.scene.add_plane(friction=1.0)
        shape = self.tool.fitted(RADIUS, SPACING)
        self.body = self.scene.add_mesh(shape, self.tool.faces, friction=self.tool.friction)
        self.solver: Solver | None = None

    def fence(self, low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
        """Hold the clay by a box that does not move."""
        box = trimesh.creation.box(bounds=(low, high))
        fence: MeshCollider = self.scene.add_mesh(box.vertices, box.faces)
        assert fence

    def move(self, *places: tuple[float, float, float], quarter: bool = False) -> None:
        """Lead the tool from the first place to the others at 0.1 m/s, a quarter turned about Z."""
        turn = np.eye(4)
        if quarter:
            turn[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
        here = np.array(places[0])
        self.body.set_pose(at(*here) @ turn)
        if self.solver is None:
            self.solver = Solver(self.scene)
        for place in places[1:]:
            way = np.array(place) - here
            steps = int(np.ceil(np.linalg.norm(way) / (0.1 / 60)))
            for step in range(steps):
                self.body.set_pose(at(*(here + way * (step + 1) / steps)) @ turn)
                self.solver.step(1 / 60)
            here = np.array(place)

    def points(self) -> NDArray[np.float32]:
        """Where the clay is [m]."""
        assert self.solver is not None
        return self.solver.positions()


@pytest.mark.parametrize("name", PRESSING)
def test_pressing_tools_leave_a_dent(name: str) -> None:
    """Press 8 mm into a block and lift again: most of the dent stays, and the clay is whole."""
    bench = Bench(name)
    above = (0.0, 0.0, bench.top + 0.002)
    bench.move(above, (0.0, 0.0, bench.top - 0.008))
    assert bench.solver is not None
    assert bench.solver.force_on(bench.body)[2] > 2.0
    bench.move((0.0, 0.0, bench.top - 0.008), above)
    points = bench.points()
    under = np.hypot(points[:, 0], points[:, 1]) < 0.5 * RADIUS
    assert points[under, 2].max() < bench.top - 0.5 * SPACING - 0.005
    assert len(pieces(points, SPACING)) == 1


def test_knife_cuts_along_its_stroke() -> None:
    """Part a block that is held, in two halves with a gap of at least half a spacing."""
    bench = Bench("knife")
    for side in (-1, 1):
        low, high = sorted((side * 0.008, side * 0.04))
        bench.fence((low, 0.025, 0.0), (high, 0.04, 0.03))
    # The tip goes through the table, which only clay feels.
    bench.move((0.0, -0.045, -0.004), (0.0, 0.045, -0.004))
    halves = pieces(bench.points(), SPACING, reach=1.5)
    assert [len(half) for half in halves] == [360, 360]


def test_wire_cuts_what_it_is_pushed_down_through() -> None:
    """Part a block in two halves that no bond joins."""
    bench = Bench("wire")
    bench.move((0.0, 0.0, 0.034), (0.0, 0.0, -0.004), quarter=True)
    halves = pieces(bench.points(), SPACING)
    assert [len(half) for half in halves] == [360, 360]


def test_loop_scrapes_a_groove() -> None:
    """Leave a groove as deep as the loop went, and the clay beside it as high as it was."""
    bench = Bench("loop", (12, 14, 8))
    bench.fence((-0.04, 0.035, 0.0), (0.04, 0.05, 0.026))
    deep = bench.top - 0.012
    bench.move((0.0, -0.06, deep), (0.0, 0.02, deep), (0.0, 0.045, bench.top + 0.025))
    points = bench.points()
    along = np.abs(points[:, 1]) < 0.015
    groove = along & (np.abs(points[:, 0]) < 0.5 * SPACING)
    beside = along & (np.abs(points[:, 0]) > 0.022)
    assert points[groove, 2].max() < bench.top - 0.5 * SPACING - 0.007
    assert points[beside, 2].max() > bench.top - 0.7 * SPACING


# A stamp of one's own ---------------------------------------------------------------------------


def test_any_closed_mesh_is_a_stamp(studio: Any) -> None:
    """Fit an object to the brush, with its scale and modifiers, wherever it stands."""
    item = studio.block(size=0.1, location=(3.0, 2.0, 1.0))
    item.scale = (2.0, 1.0, -1.0)
    item.modifiers.new("Round", "SUBSURF").levels = 2
    item.rotation_euler = (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()
    tool = stamp_from_object(item, bpy.context.evaluated_depsgraph_get())
    assert tool.label == "Cube"
    assert np.hypot(*tool.vertices[:, :2].T).max() == pytest.approx(1.0)
    assert tool.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(tool.vertices[:, 0]) == pytest.approx(2 * np.ptp(tool.vertices[:, 1]), rel=1e-3)
    assert mesh_volume(tool.vertices, tool.faces) > 0
    assert len(tool.vertices) > 50


def test_what_cannot_be_a_stamp_is_said(studio: Any) -> None:
    """Name the object and the reason."""
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    with pytest.raises(ToolPresetError, match="'Plane' is open: it has 1 hole"):
        stamp_from_object(bpy.context.object, depsgraph)
    bpy.ops.object.empty_add()
    with pytest.raises(ToolPresetError, match="'Empty' is not a mesh"):
        stamp_from_object(bpy.context.object, bpy.context.evaluated_depsgraph_get())


def test_meshes_are_those_that_are_drawn() -> None:
    """Keep the files as the script that draws them writes them."""
    import importlib.util

    script = PRESET_FOLDER.parent.parent / "tools" / "tool_meshes.py"
    spec = importlib.util.spec_from_file_location("tool_meshes", script)
    assert spec is not None
    assert spec.loader is not None
    drawing = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(drawing)
    assert {draw.__name__ for draw in drawing.TOOLS} == set(TOOLS)
    for draw in drawing.TOOLS:
        vertices, faces = draw()
        kept = load_tool_preset(draw.__name__)
        assert len(vertices) == len(kept.vertices)
        assert len(faces) == len(kept.faces)
        assert np.allclose(np.sort(vertices, axis=0), np.sort(kept.vertices, axis=0), atol=1e-4)
