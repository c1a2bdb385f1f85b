# SPDX-License-Identifier: GPL-3.0-or-later
"""The kindergarten scene has the paper's number of particles, and its hands do their work."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils.bvhtree import BVHTree  # noqa: E402

from tactile_clay.clay_addon import register, unregister  # noqa: E402
from tactile_clay.clay_addon.base.mesh_geometry import evaluated_mesh, transform  # noqa: E402
from tactile_clay.clay_addon.hands.hand import hand_objects  # noqa: E402
from tactile_clay.clay_addon.model.clay_scene import clay_colors, clay_positions, collider_objects  # noqa: E402
from tactile_clay.clay_addon.scenes import kindergarten  # noqa: E402
from tactile_clay.clay_addon.scenes.operators import add_scene  # noqa: E402
from tactile_clay.clay_addon.simulate.simulation import Simulation  # noqa: E402
from tactile_clay.solver.geometry.closed_mesh import check_closed_mesh  # noqa: E402
from tactile_clay.tests.experiments.pieces import pieces  # noqa: E402

SPACING = kindergarten.SPACING


@dataclass(frozen=True)
class Played:
    """The scene's clay before and after its two seconds."""

    before: dict[str, np.ndarray]
    """Particles of each piece at the first frame [m], shape [N, 3]."""
    after: dict[str, np.ndarray]
    """The same particles at the last frame."""
    everything: np.ndarray
    """All particles at the last frame."""
    diagnostics: Any
    """The solver's diagnostics at the last frame."""


@pytest.fixture(scope="module")
def scene() -> Iterator[kindergarten.Kindergarten]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    register()
    # Beside another scene with an object of the same name.
    bpy.context.collection.objects.link(bpy.data.objects.new("Orange Suzanne", None))
    yield add_scene(bpy.context, "Kindergarten", kindergarten.build)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    unregister()


def world_vertices(item: Any) -> np.ndarray:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return transform(item.evaluated_get(depsgraph).matrix_world, evaluated_mesh(item, depsgraph)[0])


def test_there_are_as_many_particles_as_in_the_paper(scene: kindergarten.Kindergarten) -> None:
    """Have 2,114 particles in six pieces."""
    assert len(scene.clay.data.points) == kindergarten.PARTICLE_COUNT == 2114
    assert len(scene.pieces) == 6


@pytest.fixture(scope="module")
def played(scene: kindergarten.Kindergarten) -> Played:
    """Simulate the whole scene once."""
    context = bpy.context
    context.scene.frame_set(1)
    owner = piece_of_particles(scene)
    simulation = Simulation(context)
    simulation.start(context.evaluated_depsgraph_get(), "cpu")
    before = simulation.positions()
    for frame in range(2, kindergarten.FRAME_COUNT + 1):
        context.scene.frame_set(frame)
        simulation.feed(context.evaluated_depsgraph_get())
        simulation.step()
    context.scene.frame_set(1)
    after = simulation.positions()
    names = [item.name.removesuffix(".001") for item in scene.pieces]
    assert simulation.solver is not None
    return Played(
        {name: before[owner == index] for index, name in enumerate(names)},
        {name: after[owner == index] for index, name in enumerate(names)},
        after,
        simulation.solver.diagnostics(),
    )


def piece_of_particles(scene: kindergarten.Kindergarten) -> np.ndarray:
    """Index of each particle's piece, by the bounding boxes of the meshes; -1 for none."""
    points = clay_positions(scene.clay)
    owner = np.full(len(points), -1)
    for index, item in enumerate(scene.pieces):
        vertices = world_vertices(item)
        low, high = vertices.min(axis=0) - 1e-4, vertices.max(axis=0) + 1e-4
        owner[((points >= low) & (points <= high)).all(axis=1)] = index
    return owner


def height(points: np.ndarray) -> float:
    """Height of clay, ignoring a few particles [m]."""
    return float(np.percentile(points[:, 2], 98))


def test_pieces_stand_apart(scene: kindergarten.Kindergarten) -> None:
    """Keep particles of different pieces at least two spacings apart."""
    points = clay_positions(scene.clay)
    colors = clay_colors(scene.clay)
    piece = piece_of_particles(scene)
    assert (piece >= 0).all()
    assert len(np.unique(colors, axis=0)) == len(scene.pieces) + 2
    way = np.linalg.norm(points[:, None] - points[None], axis=2)
    apart = piece[:, None] != piece[None]
    assert way[apart].min() > 2.0 * SPACING


def test_clay_stands_on_the_table(scene: kindergarten.Kindergarten) -> None:
    """Place every particle above the table, and every piece on it."""
    points = clay_positions(scene.clay)
    assert points[:, 2].min() > 0.3 * SPACING
    for item in scene.pieces:
        assert world_vertices(item)[:, 2].min() == pytest.approx(0.0, abs=1e-5)


def test_hands_are_closed_and_start_away_from_the_clay(scene: kindergarten.Kindergarten) -> None:
    """Start with hands whose meshes are closed and touch no clay."""
    bpy.context.scene.frame_set(1)
    points = clay_positions(scene.clay)
    assert list(scene.hands) == hand_objects(bpy.context.scene)[::-1]
    assert len(scene.hands) == 2
    for hand in scene.hands:
        vertices, triangles = evaluated_mesh(hand, bpy.context.evaluated_depsgraph_get())
        check_closed_mesh(vertices, triangles)
        way = np.linalg.norm(world_vertices(hand)[::4, None] - points[None], axis=2)
        assert way.min() > 2.0 * SPACING, hand.name


def test_hands_stay_above_the_table_all_the_time(scene: kindergarten.Kindergarten) -> None:
    """Let each hand reach down to the clay, but never into the table."""
    lowest = dict.fromkeys((hand.name for hand in scene.hands), np.inf)
    for frame in range(1, kindergarten.FRAME_COUNT + 1, 3):
        bpy.context.scene.frame_set(frame)
        for hand in scene.hands:
            lowest[hand.name] = min(lowest[hand.name], world_vertices(hand)[:, 2].min())
    bpy.context.scene.frame_set(1)
    for name, height in lowest.items():
        assert -0.0005 < height < 0.025, name


def test_hands_never_intersect(scene: kindergarten.Kindergarten) -> None:
    """Keep the hands from passing through each other."""
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


def test_scene_can_be_simulated_unchanged(scene: kindergarten.Kindergarten) -> None:
    """Provide everything a bake needs: clay, table and hands."""
    simulation = Simulation(bpy.context)
    assert simulation.spacing == pytest.approx(SPACING)
    assert simulation.time_step == pytest.approx(1 / 60)
    assert [item.name for item in collider_objects(bpy.context.scene)] == ["Table"]
    assert len(simulation.hands) == 2


def test_a_palm_flattens_the_red_block(played: Played) -> None:
    """Flatten the block to at most two thirds of its height, and widen it."""
    before, after = played.before["Red block"], played.after["Red block"]
    assert 0.4 < height(after) / height(before) < 0.67
    assert (np.ptp(after[:, :2], axis=0) > 1.15 * np.ptp(before[:, :2], axis=0)).all()
    assert len(pieces(after, SPACING)) == 1


def test_a_pinch_takes_the_head_off_the_caterpillar(played: Played) -> None:
    """Leave two large pieces, farther apart than a head."""
    assert len(pieces(played.before["Green caterpillar"], SPACING)) == 1
    body, head, *crumbs = pieces(played.after["Green caterpillar"], SPACING)
    assert sum(map(len, crumbs)) <= 4
    assert 100 <= len(head) <= 160
    after = played.after["Green caterpillar"]
    assert after[head, 0].min() - after[body, 0].max() > 0.03


def test_two_hands_merge_two_blocks(played: Played) -> None:
    """Push yellow and blue together symmetrically, so that they stay together."""
    before, after = (
        np.concatenate([state["Yellow block"], state["Blue block"]])
        for state in (played.before, played.after)
    )
    assert [len(piece) for piece in pieces(before, SPACING)] == [208, 208]
    assert [len(piece) for piece in pieces(after, SPACING)] == [416]
    assert np.ptp(after[:, 0]) < np.ptp(before[:, 0]) - 0.010
    assert after[:, 0].mean() == pytest.approx(before[:, 0].mean(), abs=0.002)


def test_a_finger_leaves_a_dent_in_the_violet_block(played: Played) -> None:
    """Press in the middle of the top by 7 to 12 mm, but not its corners."""
    before, after = played.before["Violet block"], played.after["Violet block"]
    top = before[:, 2] > before[:, 2].max() - 0.5 * SPACING
    sunk = (before - after)[top, 2]
    away = np.linalg.norm(before[top, :2] - before[:, :2].mean(axis=0), axis=1)
    assert 0.007 < np.sort(sunk)[-4:].mean() < 0.012
    assert away[np.argsort(sunk)[-4:]].max() < 0.008
    assert sunk[away > 0.014].max() < 0.004


def test_nothing_else_is_disturbed(played: Played) -> None:
    """Keep Suzanne in place, the clay's volume constant, and all particles above the table."""
    moved = played.after["Orange Suzanne"] - played.before["Orange Suzanne"]
    assert np.linalg.norm(moved.mean(axis=0)) < 0.001
    assert abs(played.diagnostics.volume_error) < 0.005
    assert played.diagnostics.quarantined == played.diagnostics.overflow == 0
    assert played.everything[:, 2].min() > 0.0
