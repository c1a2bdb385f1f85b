# SPDX-License-Identifier: GPL-3.0-or-later
"""Binding: tetrahedra that fill the hand without connecting fingers, and ghosts on the skin."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_clay.solver.geometry.closed_mesh import mesh_area
from tactile_clay.solver.geometry.lattice_tetrahedra import tetrahedron_volumes
from tactile_clay.solver.geometry.skin_query import SkinQuery
from tactile_clay.solver.hand.binding import bind_hand
from tactile_clay.solver.hand.default_hand import default_hand
from tactile_clay.solver.hand.ghosts import rasterize_ghosts
from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.hand.skinned_hand import SkinnedHand

from .hand_poses import FIST, curled, pose_bones

FINGERS = ("thumb", "index", "middle", "ring", "little")


@pytest.fixture(scope="module")
def hand() -> SkinnedHand:
    return default_hand()


@pytest.fixture(scope="module")
def rig(hand: SkinnedHand) -> HandRig:
    return bind_hand(hand, clay_spacing=0.008)


def ghosts_on(rig: HandRig, vertices: np.ndarray) -> np.ndarray:
    """Positions of the ghosts on the skin itself [m]."""
    ghosts = rasterize_ghosts(rig.vertices, rig.faces, rig.ghost_spacing)
    return ghosts.positions(vertices, rig.faces)


def ghost_errors(hand: SkinnedHand, rig: HandRig, bones: dict) -> np.ndarray:
    """Distance of each ghost from its position on the linearly skinned mesh [m]."""
    carried = rig.carried_ghosts(rig.skinned_nodes(bones))
    return np.linalg.norm(carried - ghosts_on(rig, hand.posed(bones)), axis=1)


def outer_vertices(hand: SkinnedHand, finger: str) -> np.ndarray:
    """Which vertices belong to a finger's distal bone."""
    strongest = hand.weights.argmax(1)
    return strongest == hand.bone_names.index(f"{finger}_distal")


# At rest -----------------------------------------------------------------------------------------


def test_binding_is_exact_at_rest(hand: SkinnedHand, rig: HandRig) -> None:
    """Reproduce the skin and the ghosts at rest within a nanometer."""
    assert np.abs(rig.carried_vertices(rig.nodes) - hand.vertices).max() < 1e-9
    assert np.abs(rig.carried_ghosts(rig.nodes) - ghosts_on(rig, hand.vertices)).max() < 1e-9
    np.testing.assert_allclose(rig.skinned_nodes({}), rig.nodes, atol=1e-12)


def test_ghosts_represent_the_whole_skin(hand: SkinnedHand, rig: HandRig) -> None:
    """Have areas that sum to the skin's, and unit normals that point outwards."""
    assert rig.ghost_areas.sum() == pytest.approx(mesh_area(hand.vertices, hand.faces), rel=1e-9)
    assert (rig.ghost_areas > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(rig.ghost_normals, axis=1), 1.0)
    ghosts = rig.carried_ghosts(rig.nodes)
    skin = SkinQuery(hand.vertices, hand.faces)
    assert (skin.nearest(ghosts + 5e-4 * rig.ghost_normals).depth < 0.0).all()
    # On a closed surface the integral of the normal vanishes.
    flux = (rig.ghost_areas[:, None] * rig.ghost_normals).sum(0)
    assert np.abs(flux).max() < 0.01 * rig.ghost_areas.sum()


def test_ghost_spacing_is_half_the_clays(hand: SkinnedHand, rig: HandRig) -> None:
    """Be half the clay's spacing apart, which is a particle's radius."""
    assert rig.ghost_spacing == pytest.approx(0.004)
    finer = bind_hand(hand, clay_spacing=0.004)
    assert len(finer.ghost_areas) == pytest.approx(4 * len(rig.ghost_areas), rel=0.15)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_no_particle_leaks_between_ghosts(hand: SkinnedHand, rig: HandRig, share: float) -> None:
    """Leave hardly a point of the skin farther from a ghost than a particle's radius."""
    bones = pose_bones(curled(share))
    mesh = trimesh.Trimesh(hand.posed(bones), hand.faces, process=False)
    points, _ = trimesh.sample.sample_surface(mesh, 5000, seed=1)
    rest = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    rest_points, _ = trimesh.sample.sample_surface(rest, 5000, seed=1)
    gap = nearest(rest_points, rig.carried_ghosts(rig.nodes))
    assert gap.max() < rig.ghost_spacing / np.sqrt(2.0) + 1e-6
    # Where linear skinning stretches the skin, the ghosts move apart.
    gap = nearest(points, ghosts_on(rig, hand.posed(bones)))
    radius = rig.ghost_spacing
    assert np.percentile(gap, 99.9) < radius
    assert gap.max() < 1.6 * radius


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance from each point to the nearest of the others."""
    result = []
    for part in np.array_split(points, 40):
        square = (part**2).sum(1)[:, None] + (others**2).sum(1) - 2.0 * part @ others.T
        result.append(np.sqrt(np.maximum(square.min(1), 0.0)))
    return np.concatenate(result)


# Tetrahedra --------------------------------------------------------------------------------------


def test_skin_is_carried_by_its_own_finger(hand: SkinnedHand, rig: HandRig) -> None:
    """Carry the outer skin of different fingers by different nodes."""
    carried = {
        finger: set(
            rig.tetrahedra[rig.vertex_tetrahedron[outer_vertices(hand, finger)]].ravel().tolist()
        )
        for finger in FINGERS
    }
    for first in FINGERS:
        for second in FINGERS:
            if first < second:
                assert not carried[first] & carried[second]


@pytest.mark.parametrize("cell", [0.008, 0.016])
def test_one_finger_moves_alone(hand: SkinnedHand, cell: float) -> None:
    """Bend the middle finger without moving the other fingers' ghosts."""
    rig = bind_hand(hand, clay_spacing=0.012, cell=cell)
    rest = pose_bones(curled(0.0))
    bent = pose_bones(replace(curled(0.0), middle=curled(1.0).middle))
    ghosts = rasterize_ghosts(rig.vertices, rig.faces, rig.ghost_spacing)
    corner = rig.faces[ghosts.face, ghosts.weights.argmax(1)]
    moved = rig.carried_ghosts(rig.skinned_nodes(bent)) - rig.carried_ghosts(
        rig.skinned_nodes(rest)
    )
    for finger in FINGERS:
        distance = np.linalg.norm(moved[outer_vertices(hand, finger)[corner]], axis=1)
        if finger == "middle":
            assert np.median(distance) > 0.03
        else:
            assert distance.max() < 1e-9


@pytest.mark.parametrize("length", [0.10, 0.19, 0.25])
def test_hands_of_any_size_have_about_500_nodes(length: float) -> None:
    """Choose the lattice's cell by the hand's size."""
    small = bind_hand(default_hand(length=length), clay_spacing=0.06 * length)
    assert 425 < len(small.nodes) < 575
    assert (tetrahedron_volumes(small.nodes, small.tetrahedra) > 0.0).all()


# Posed -------------------------------------------------------------------------------------------


def test_nodes_follow_at_most_four_bones(rig: HandRig) -> None:
    """Give every node up to four bones, with nonnegative weights that sum to one."""
    assert rig.node_weights.shape[1] == 4
    assert (rig.node_weights >= 0.0).all()
    np.testing.assert_allclose(rig.node_weights.sum(1), 1.0)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_ghosts_stay_on_the_skin_over_a_full_curl(
    hand: SkinnedHand, rig: HandRig, share: float
) -> None:
    """Keep ghosts near the linearly skinned mesh: a median of half a millimeter in a fist."""
    errors = ghost_errors(hand, rig, pose_bones(curled(share)))
    assert np.median(errors) < 1e-4 + 4e-4 * share
    assert np.percentile(errors, 99) < 1e-3 + 3e-3 * share
    assert errors.max() < 2e-3 + 7e-3 * share


def test_finer_lattices_follow_the_skin_better(hand: SkinnedHand) -> None:
    """At least halve the median error with half the cell, as linear interpolation does."""
    bones = pose_bones(FIST)
    coarse, fine = (
        np.median(ghost_errors(hand, bind_hand(hand, clay_spacing=0.012, cell=cell), bones))
        for cell in (0.016, 0.008)
    )
    assert fine < 0.5 * coarse


def test_skinning_inverts_hardly_any_tetrahedra(rig: HandRig) -> None:
    """Invert less than 1 % of the tetrahedra in a fist, and none up to half a curl."""
    for share, limit in ((0.25, 0.0), (0.5, 0.0), (1.0, 0.01)):
        nodes = rig.skinned_nodes(pose_bones(curled(share)))
        assert (tetrahedron_volumes(nodes, rig.tetrahedra) <= 0.0).mean() <= limit


def test_rigid_motion_is_followed_exactly(hand: SkinnedHand, rig: HandRig) -> None:
    """Move the hand like a rigid body if all bones do."""
    motion = np.eye(4)
    motion[:3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    motion[:3, :3] *= np.linalg.det(motion[:3, :3])
    motion[:3, 3] = 0.3, -0.2, 0.9
    bones = {n: motion @ m for n, m in zip(rig.bone_names, rig.bone_rest, strict=True)}
    carried = rig.carried_vertices(rig.skinned_nodes(bones))
    np.testing.assert_allclose(carried, hand.vertices @ motion[:3, :3].T + motion[:3, 3], atol=1e-9)


# Any rig -----------------------------------------------------------------------------------------


def reposed(hand: SkinnedHand, pose: Any) -> SkinnedHand:
    """The same hand with another rest pose."""

    bones = pose_bones(pose)
    rest = np.stack([bones[name] for name in hand.bone_names])
    return replace(hand, vertices=hand.posed(bones), bone_rest=rest)


@pytest.mark.parametrize("pose", ["pinch", FIST], ids=["pinch", "fist"])
def test_rest_pose_may_have_fingers_that_touch(hand: SkinnedHand, pose: Any) -> None:
    """Separate fingers that touch each other or the palm at rest, when the hand opens."""
    closed = reposed(hand, pose)
    rig = bind_hand(closed, clay_spacing=0.012, cell=0.014)
    errors = ghost_errors(closed, rig, pose_bones("flat"))
    # A coarse lattice is less accurate over such a rotation; a connected finger would be off by
    # centimeters.
    assert np.median(errors) < 5e-4
    assert np.percentile(errors, 99) < 0.012
    assert errors.max() < 0.025


def test_seams_are_welded(hand: SkinnedHand, rig: HandRig) -> None:
    """Bind a hand whose faces share no vertices like one whose faces do."""
    corners = hand.faces.ravel()
    torn = replace(
        hand,
        vertices=hand.vertices[corners],
        faces=np.arange(len(corners), dtype=np.int32).reshape(-1, 3),
        weights=hand.weights[corners],
    )
    bound = bind_hand(torn, clay_spacing=0.008)
    assert len(bound.vertices) == len(hand.vertices)
    assert len(bound.nodes) == pytest.approx(len(rig.nodes), rel=0.02)
    assert bound.ghost_areas.sum() == pytest.approx(rig.ghost_areas.sum())


def test_bones_may_come_in_any_order_and_without_parents(hand: SkinnedHand, rig: HandRig) -> None:
    """Sort bones with parents first, and find missing parents by name."""
    order = np.random.default_rng(0).permutation(26)
    position = np.argsort(order)
    shuffled = replace(
        hand,
        bone_names=tuple(hand.bone_names[bone] for bone in order),
        bone_rest=hand.bone_rest[order],
        bone_parent=np.array(
            [position[p] if p >= 0 else -1 for p in hand.bone_parent[order]], np.int32
        ),
        weights=hand.weights[:, order],
    )
    loose = replace(shuffled, bone_parent=np.full(26, -1, np.int32))
    for given in (shuffled, loose):
        bound = bind_hand(given, clay_spacing=0.008)
        assert (bound.bone_parent < np.arange(26)).all()
        assert len(bound.nodes) == len(rig.nodes)
        bones = pose_bones(FIST)
        np.testing.assert_allclose(bound.skinned_nodes(bones), rig.skinned_nodes(bones), atol=1e-6)


def test_binding_is_reproducible(hand: SkinnedHand, rig: HandRig) -> None:
    """Give the same bits twice, also after conversion to arrays and back."""
    again = HandRig.from_arrays(bind_hand(hand, clay_spacing=0.008).to_arrays())
    for name, array in rig.to_arrays().items():
        np.testing.assert_array_equal(array, again.to_arrays()[name], err_msg=name)


def test_non_uniform_scale_and_distance_are_supported(hand: SkinnedHand) -> None:
    """Bind and pose a stretched hand ten meters from the origin as accurately."""
    stretch = np.diag([1.2, 0.8, 1.5, 1.0])
    stretch[:3, 3] = 10.0, -10.0, 5.0
    stretched = replace(
        hand,
        vertices=hand.vertices @ stretch[:3, :3].T + stretch[:3, 3],
        bone_rest=stretch @ hand.bone_rest,
    )
    rig = bind_hand(stretched, clay_spacing=0.012)
    assert np.abs(rig.carried_vertices(rig.nodes) - stretched.vertices).max() < 1e-9
    bones = {name: stretch @ matrix for name, matrix in pose_bones(curled(0.7)).items()}
    errors = ghost_errors(stretched, rig, bones)
    assert np.median(errors) < 5e-4 and errors.max() < 0.012


def test_rotated_hand_is_bound_alike(hand: SkinnedHand, rig: HandRig) -> None:
    """Align the lattice with the hand, so that the hand's orientation does not matter."""
    motion = np.eye(4)
    motion[:3, :3] = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    motion[:3, :3] *= np.linalg.det(motion[:3, :3])
    motion[:3, 3] = 1.0, -2.0, 3.0
    turned = bind_hand(
        replace(
            hand,
            vertices=hand.vertices @ motion[:3, :3].T + motion[:3, 3],
            bone_rest=motion @ hand.bone_rest,
        ),
        clay_spacing=0.008,
    )
    assert len(turned.nodes) == pytest.approx(len(rig.nodes), rel=0.01)
    bones = pose_bones(FIST)
    moved = {name: motion @ matrix for name, matrix in bones.items()}
    errors = np.linalg.norm(
        rig.carried_vertices(rig.skinned_nodes(bones)) - hand.posed(bones), axis=1
    )
    turned_errors = np.linalg.norm(
        turned.carried_vertices(turned.skinned_nodes(moved))
        - (hand.posed(bones) @ motion[:3, :3].T + motion[:3, 3]),
        axis=1,
    )
    assert np.median(turned_errors) == pytest.approx(np.median(errors), rel=0.05)


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_scale_changes_only_sizes(hand: SkinnedHand, factor: float) -> None:
    """Bind tiny and huge hands alike."""
    rest = hand.bone_rest.copy()
    rest[:, :3, 3] *= factor
    scaled = replace(hand, vertices=factor * hand.vertices, bone_rest=rest)
    one, other = (
        bind_hand(hand, clay_spacing=0.012),
        bind_hand(scaled, clay_spacing=0.012 * factor),
    )
    assert len(other.nodes) == pytest.approx(len(one.nodes), rel=0.01)
    assert len(other.ghost_areas) == pytest.approx(len(one.ghost_areas), rel=0.05)
    assert np.abs(other.carried_vertices(other.nodes) - scaled.vertices).max() < 1e-9 * factor
