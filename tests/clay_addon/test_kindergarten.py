# SPDX-License-Identifier: GPL-3.0-or-later
"""The kindergarten scene: the paper's number of particles, pieces that stand free, hands off."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils.bvhtree import BVHTree  # noqa: E402

from tactile_clay.clay_addon import kindergarten, register, unregister  # noqa: E402
from tactile_clay.clay_addon.mesh_geometry import evaluated_mesh, transform  # noqa: E402
from tactile_clay.clay_addon.simulation import (  # noqa: E402
    Simulation,
    clay_colors,
    collider_objects,
    rest_positions,
)
from tactile_clay.solver.closed_mesh import check_closed_mesh  # noqa: E402


@pytest.fixture(scope="module")
def scene() -> Iterator[kindergarten.Kindergarten]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    register()
    yield kindergarten.build(bpy.context)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    unregister()


def world_vertices(item: Any) -> np.ndarray:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return transform(item.evaluated_get(depsgraph).matrix_world, evaluated_mesh(item, depsgraph)[0])


def test_there_are_as_many_particles_as_in_the_paper(scene: kindergarten.Kindergarten) -> None:
    """Hold 2,114 particles, each piece its share."""
    assert len(scene.clay.data.points) == kindergarten.PARTICLE_COUNT == 2114
    assert len(scene.pieces) == 6


def test_pieces_stand_apart(scene: kindergarten.Kindergarten) -> None:
    """Leave at least a particle's diameter between particles of two pieces."""
    points = rest_positions(scene.clay)
    colors = clay_colors(scene.clay)
    # Suzanne's eyes have colours of their own, so a piece is told by where its mesh is.
    piece = np.full(len(points), -1)
    for index, item in enumerate(scene.pieces):
        vertices = world_vertices(item)
        low, high = vertices.min(axis=0) - 1e-4, vertices.max(axis=0) + 1e-4
        piece[((points >= low) & (points <= high)).all(axis=1)] = index
    assert (piece >= 0).all()
    assert len(np.unique(colors, axis=0)) == len(scene.pieces) + 2
    way = np.linalg.norm(points[:, None] - points[None], axis=2)
    apart = piece[:, None] != piece[None]
    assert way[apart].min() > 2.0 * kindergarten.SPACING


def test_clay_stands_on_the_table(scene: kindergarten.Kindergarten) -> None:
    """Put every particle above the table, and some of every piece down on it."""
    points = rest_positions(scene.clay)
    assert points[:, 2].min() > 0.3 * kindergarten.SPACING
    for item in scene.pieces:
        assert world_vertices(item)[:, 2].min() == pytest.approx(0.0, abs=1e-5)


def test_hands_are_closed_and_begin_off_the_clay(scene: kindergarten.Kindergarten) -> None:
    """Start with closed hands around which there is no clay."""
    bpy.context.scene.frame_set(1)
    points = rest_positions(scene.clay)
    assert len(scene.hands) == 5
    for hand in scene.hands:
        vertices, triangles = evaluated_mesh(hand, bpy.context.evaluated_depsgraph_get())
        check_closed_mesh(vertices, triangles)
        way = np.linalg.norm(world_vertices(hand)[::4, None] - points[None], axis=2)
        assert way.min() > 2.0 * kindergarten.SPACING, hand.name


def test_hands_stay_above_the_table_all_the_time(scene: kindergarten.Kindergarten) -> None:
    """Reach down to the clay in every hand's path, and never into the wood."""
    lowest = dict.fromkeys((hand.name for hand in scene.hands), np.inf)
    for frame in range(1, kindergarten.FRAME_COUNT + 1, 3):
        bpy.context.scene.frame_set(frame)
        for hand in scene.hands:
            lowest[hand.name] = min(lowest[hand.name], world_vertices(hand)[:, 2].min())
    bpy.context.scene.frame_set(1)
    for name, height in lowest.items():
        assert -0.0005 < height < 0.025, name


def test_hands_keep_out_of_each_other(scene: kindergarten.Kindergarten) -> None:
    """Let no hand pass through another one."""
    for frame in range(1, kindergarten.FRAME_COUNT + 1, 4):
        bpy.context.scene.frame_set(frame)
        trees = [
            BVHTree.FromPolygons(
                world_vertices(hand).tolist(),
                evaluated_mesh(hand, bpy.context.evaluated_depsgraph_get())[1].tolist(),
            )
            for hand in scene.hands
        ]
        for first, second in combinations(range(len(trees)), 2):
            names = scene.hands[first].name, scene.hands[second].name
            assert not trees[first].overlap(trees[second]), (frame, *names)
    bpy.context.scene.frame_set(1)


def test_scene_can_be_simulated_as_it_is(scene: kindergarten.Kindergarten) -> None:
    """Give the bake everything it needs: clay, table and hands."""
    simulation = Simulation(bpy.context)
    assert simulation.spacing == pytest.approx(kindergarten.SPACING)
    assert simulation.time_step == pytest.approx(1 / 60)
    assert len(collider_objects(bpy.context.scene)) == len(scene.hands) + 1
