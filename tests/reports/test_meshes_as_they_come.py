# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes from users' files become the clay that one expects, or are refused with a reason."""

import itertools
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.clay.meshes import ClayError

SPACING = 0.005


def add_mesh(name: str, vertices: Any, faces: Any) -> bpy.types.Object:
    """A mesh object from arrays."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(
        [tuple(map(float, v)) for v in vertices], [], [tuple(map(int, f)) for f in faces]
    )
    item = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(item)
    return item


def ball(radius: float, center: tuple[float, float, float] = (0, 0, 0), *, detail: int = 4) -> Any:
    """Vertices and faces of a ball."""
    shape = trimesh.creation.icosphere(subdivisions=detail - 1, radius=radius)
    return np.asarray(shape.vertices) + center, np.asarray(shape.faces)


def box(size: tuple[float, float, float], center: tuple[float, float, float] = (0, 0, 0)) -> Any:
    """Vertices and faces of a box, of quadrilaterals."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size + center
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array(faces)


def joined(*parts: Any) -> Any:
    """Several meshes joined into one."""
    vertices = np.concatenate([part[0] for part in parts])
    starts = np.cumsum([0, *(len(part[0]) for part in parts)])
    faces = [f + s for (_, part), s in zip(parts, starts, strict=False) for f in part]
    return vertices, faces


def clay_of(*items: bpy.types.Object, **options: Any) -> tuple[NDArray[np.float64], list[str]]:
    """World positions of the clay made from objects, and the notes to the user."""
    notes: list[str] = []
    bpy.context.view_layer.update()
    clay = make_clay(bpy.context, items, SPACING, on_note=notes.append, **options)
    points = np.empty((len(clay.data.points), 3), np.float32)
    clay.data.attributes["position"].data.foreach_get("vector", points.ravel())
    return points + np.array(clay.location), notes


@pytest.mark.parametrize("inverted", [(), (0,), (1,), (0, 1), (2,), (0, 2)])
def test_bodies_inside_out_are_all_filled(studio: Any, inverted: tuple[int, ...]) -> None:
    """Fill each body in a mesh whichever way its faces point, and report which were flipped."""
    parts = [box((0.06, 0.06, 0.06)), ball(0.03, (0.2, 0, 0)), box((0.03, 0.05, 0.04), (0, 0.2, 0))]
    for index in inverted:
        parts[index] = (parts[index][0], parts[index][1][:, ::-1])
    points, notes = clay_of(add_mesh("bodies", *joined(*parts)))
    for center, volume in (((0, 0), 0.06**3), ((0.2, 0), 4 / 3 * np.pi * 2.7e-5), ((0, 0.2), 6e-5)):
        near = np.linalg.norm(points[:, :2] - center, axis=1) < 0.08
        assert near.sum() * SPACING**3 == pytest.approx(volume, rel=0.1)
    assert any("inside out" in note and "'bodies'" in note for note in notes) == bool(inverted)


@pytest.mark.parametrize("inverted", [False, True])
def test_the_same_body_twice_is_clay_once(studio: Any, inverted: bool) -> None:
    """Neither double the clay's density nor cancel it."""
    vertices, faces = box((0.06, 0.06, 0.06))
    second = faces[:, ::-1] if inverted else faces
    points, notes = clay_of(add_mesh("twice", *joined((vertices, faces), (vertices, second))))
    assert len(points) == 12**3
    assert any("duplicate" in note or "inside out" in note for note in notes)


def test_bodies_that_overlap_are_clay_once(studio: Any) -> None:
    """Fill the union of two balls in one mesh evenly."""
    points, _ = clay_of(add_mesh("two", *joined(ball(0.03), ball(0.03, (0.03, 0, 0)))))
    lens = np.pi / 12 * (4 * 0.03 + 0.03) * (2 * 0.03 - 0.03) ** 2
    assert len(points) * SPACING**3 == pytest.approx(8 / 3 * np.pi * 2.7e-5 - lens, rel=0.02)
    gap = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
    assert gap.min() > 0.99 * SPACING


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
def test_sheet_thinner_than_the_spacing_is_refused_or_followed(studio: Any, angle: float) -> None:
    """Report the thickness and a suitable spacing; make one layer on request."""
    sheet = add_mesh("sheet", *box((0.1, 0.1, 0.001)))
    sheet.rotation_euler = (angle, 0.3 * angle, 0)
    with pytest.raises(ClayError, match=r"'sheet' has walls about 1 mm.*at most (0.9\d?|1) mm"):
        clay_of(sheet)
    assert not sheet.hide_get()
    points, notes = clay_of(sheet, follow_thin_walls=True)
    assert len(points) == pytest.approx(400, rel=0.1)
    flat = points @ np.array(sheet.rotation_euler.to_matrix())
    assert np.ptp(flat[:, 2]) < 0.1 * SPACING
    assert np.ptp(flat[:, 0]) > 0.09
    assert any("One layer" in note for note in notes)


@pytest.mark.parametrize("distance", [0.5, 2.0, 1e4])
def test_loose_vertex_far_away_costs_nothing(studio: Any, distance: float) -> None:
    """Make the same clay as without it, and report that it was removed."""
    vertices, faces = box((0.06, 0.06, 0.06))
    item = add_mesh("loose", np.concatenate([vertices, [(distance, 0, 0)]]), faces)
    points, notes = clay_of(item)
    assert len(points) == 12**3
    assert any("without faces" in note for note in notes)


@pytest.mark.parametrize("noise", [1e-8, 1e-7, 1e-6])
def test_nearly_welded_corners_are_no_holes(studio: Any, noise: float) -> None:
    """Make clay of a mesh whose faces all have their own, nearly coincident corners."""
    vertices, faces = ball(0.03, detail=3)
    corners = vertices[faces].reshape(-1, 3)
    corners = corners + np.random.default_rng(0).uniform(-noise, noise, corners.shape)
    points, notes = clay_of(add_mesh("seams", corners, np.arange(len(corners)).reshape(-1, 3)))
    assert len(points) * SPACING**3 == pytest.approx(1.12e-4, rel=0.05)
    assert any("welded" in note for note in notes)


def _instancing_nodes(collection_object: bpy.types.Object) -> bpy.types.NodeTree:
    """Nodes that show an object at each vertex instead of the mesh."""
    tree = bpy.data.node_groups.new("instances", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    source, output = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    info = tree.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = collection_object
    info.inputs["As Instance"].default_value = True
    place = tree.nodes.new("GeometryNodeInstanceOnPoints")
    tree.links.new(source.outputs[0], place.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], place.inputs["Instance"])
    tree.links.new(place.outputs["Instances"], output.inputs[0])
    return tree


@pytest.mark.parametrize("scale", [1.0, -1.0, 0.5])
def test_instances_of_geometry_nodes_are_clay(studio: Any, scale: float) -> None:
    """Make clay of instances, at their visible position and size."""
    pellet = add_mesh("pellet", *ball(0.02))
    item = add_mesh("points", [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [])
    item.modifiers.new("nodes", "NODES").node_group = _instancing_nodes(pellet)
    item.scale = (scale, scale, scale)
    item.location = (0.3, 0, 0)
    points, _ = clay_of(item)
    assert len(points) * SPACING**3 == pytest.approx(3 * 3.3e-5 * abs(scale) ** 3, rel=0.06)
    centers = np.array([(0.3, 0, 0), (0.3 + 0.1 * scale, 0, 0), (0.3, 0.1 * scale, 0)])
    gap = np.linalg.norm(points[:, None] - centers[None], axis=2).min(1)
    assert gap.max() < 0.021 * abs(scale) + 0.5 * SPACING


def test_instanced_collection_is_refused_with_advice(studio: Any) -> None:
    """Name the operator that turns a collection's instances into meshes."""
    empty = bpy.data.objects.new("group", None)
    empty.instance_type = "COLLECTION"
    empty.instance_collection = bpy.data.collections.new("inner")
    bpy.context.collection.objects.link(empty)
    with pytest.raises(ClayError, match=r"'group'.*Make Instances Real"):
        clay_of(empty)


def test_many_faces_are_quick(studio: Any, tmp_path: Path) -> None:
    """Fill a ball of 82,000 faces in time that does not grow as faces times particles."""
    times = []
    for detail in (5, 7):
        item = add_mesh("ball", *ball(0.05, detail=detail))
        began = time.process_time()
        clay_of(item)
        times.append(time.process_time() - began)
    # Sixteen times the faces: with a query for each point, filling took a hundred times as long.
    assert times[1] < 40 * times[0]
