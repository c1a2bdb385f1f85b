# SPDX-License-Identifier: GPL-3.0-or-later
"""The character scene: pieces that stick, and tools that start and end away from the clay."""

from collections.abc import Iterator

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector  # noqa: E402
from mathutils.kdtree import KDTree  # noqa: E402

from tactile_clay.clay_addon import register, unregister  # noqa: E402
from tactile_clay.clay_addon.base.mesh_geometry import evaluated_mesh, transform  # noqa: E402
from tactile_clay.clay_addon.model.clay_scene import clay_colors, clay_positions, collider_objects  # noqa: E402
from tactile_clay.clay_addon.scenes import character as character_scene  # noqa: E402
from tactile_clay.clay_addon.scenes.character_parts import HEAD, Skin  # noqa: E402
from tactile_clay.clay_addon.scenes.character_tools import bow_shape, mirrored  # noqa: E402
from tactile_clay.clay_addon.scenes.operators import add_scene  # noqa: E402
from tactile_clay.solver.geometry.closed_mesh import check_closed_mesh, mesh_volume  # noqa: E402

SPACING = character_scene.SPACING


@pytest.fixture(scope="module")
def scene() -> Iterator[character_scene.Character]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    register()
    yield add_scene(bpy.context, "Character", character_scene.build)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    unregister()


def tool_points(scene: character_scene.Character, frame: int) -> list[np.ndarray]:
    """Vertices of the tools at a frame [m]."""
    bpy.context.scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return [
        transform(tool.evaluated_get(depsgraph).matrix_world, evaluated_mesh(tool, depsgraph)[0])
        for tool in scene.tools
    ]


def test_there_is_enough_clay_for_detail(scene: character_scene.Character) -> None:
    """Have 12,000 to 30,000 particles in six colors."""
    assert 12_000 < len(scene.clay.data.points) < 30_000
    assert len(np.unique(clay_colors(scene.clay), axis=0)) == 6


def test_pellets_stick_to_the_bust_and_the_rest_lies_beside_it(
    scene: character_scene.Character,
) -> None:
    """Let each color touch other clay, except three balls that lie on the board."""
    points = clay_positions(scene.clay)
    assert points[:, 2].min() > 0.0
    beside = points[:, 0] > 0.75 * HEAD
    assert beside.sum() > 300 and (points[beside, 2] < 0.03).all()
    tints, color = np.unique(clay_colors(scene.clay), axis=0, return_inverse=True)
    for index in range(len(tints)):
        own = (color == index) & ~beside
        others = KDTree(int((~own & ~beside).sum()))
        for number, place in enumerate(points[~own & ~beside].tolist()):
            others.insert(place, number)
        others.balance()
        ways = [others.find(place)[2] for place in points[own].tolist()]
        assert 0.5 * SPACING <= min(ways) < 1.2 * SPACING
    gaps = np.linalg.norm(points[beside][:, None] - points[~beside][None, ::5], axis=2)
    assert gaps.min() > 3.0 * SPACING


def test_every_tool_works_and_ends_far_from_the_clay(
    scene: character_scene.Character,
) -> None:
    """Bring each tool near the clay at least once, and keep it away at the first and last frame."""
    points = clay_positions(scene.clay)
    tree = KDTree(len(points))
    for index, place in enumerate(points.tolist()):
        tree.insert(place, index)
    tree.balance()
    nearest = np.full(len(scene.tools), np.inf)
    for frame in (1, *range(4, character_scene.FRAME_COUNT, 6), character_scene.FRAME_COUNT):
        for index, vertices in enumerate(tool_points(scene, frame)):
            way = min(tree.find(vertex)[2] for vertex in vertices[::5].tolist())
            nearest[index] = min(nearest[index], way)
            if frame == 1:
                assert way > 0.5 * SPACING, scene.tools[index].name
            elif frame == character_scene.FRAME_COUNT:
                assert way > 0.1, scene.tools[index].name
            assert vertices[:, 2].min() > 0.0
    bpy.context.scene.frame_set(1)
    assert nearest.max() < 2.0 * SPACING
    assert {item.name for item in collider_objects(bpy.context.scene)} == {
        "Board",
        *(tool.name for tool in scene.tools),
    }


def test_ray_hits_skin_or_is_refused(scene: character_scene.Character) -> None:
    """Find the front of the face with an outward normal, and refuse a ray that misses."""
    skin = Skin(scene.pieces[0])
    place, out = skin.front(0.0, 0.5 * skin.high[2])
    assert place.y == pytest.approx(skin.low[1], abs=0.06) and out.y < -0.3
    with pytest.raises(ValueError, match="hits nothing"):
        skin.front(1.0, 0.1)


def test_mirroring_twice_changes_nothing() -> None:
    """Mirror a spot to the other side and back."""
    spot = Vector((0.1, 0.2, 0.3)), Vector((0.6, -0.8, 0.0))
    assert mirrored(spot)[0].x == pytest.approx(-0.1)
    assert mirrored(mirrored(spot)) == spot


def test_bow_is_a_closed_rod_of_the_given_thickness() -> None:
    """Close the rod, orient its faces outward, and start it at height 0."""
    vertices, faces = bow_shape(0.013, 0.003, 1.0)
    triangles = np.array(
        [(face[0], face[n], face[n + 1]) for face in faces for n in range(1, len(face) - 1)]
    )
    vertices, triangles = check_closed_mesh(vertices, triangles)
    whole = np.pi * 0.003**2 * 2 * 0.013 + 4 / 3 * np.pi * 0.003**3
    assert mesh_volume(vertices, triangles) == pytest.approx(whole, rel=0.08)
    assert np.ptp(vertices, axis=0)[2] == pytest.approx(0.006)
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)
