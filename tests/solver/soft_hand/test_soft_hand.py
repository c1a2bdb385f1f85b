# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft hands and clay: two-way forces, and contact without explosions or tunneling."""

from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Hand, HandRig, Material, Scene, Settings, Solver
from tactile_clay.tests.experiments.hand_shapes import finger, is_inside, posed, slab
from tactile_clay.tests.experiments.shapes import at, block

SPACING = 0.005
FRAME = 1 / 60


@pytest.fixture(scope="module")
def rig() -> HandRig:
    """A finger that points down, its tip at the origin."""
    return finger(0.008)


@pytest.fixture(scope="module")
def palm() -> HandRig:
    """A palm that faces up, with its skin at z = 0."""
    return slab(0.013, ghost_spacing=0.004)


def over_a_block(
    rig: HandRig, counts: tuple[int, int, int] = (8, 8, 6), **options: Any
) -> tuple[Scene, Hand]:
    """A block on a table and a finger above it."""
    material = options.pop("material", Material())
    scene = Scene(SPACING)
    scene.add_clay(block(counts, SPACING), material)
    scene.add_plane()
    hand = scene.add_hand(rig, **options)
    hand.set_bones(posed(rig, at(0, 0, counts[2] * SPACING + 0.001)))
    return scene, hand


def press(solver: Solver, hand: Hand, start: float, frames: range) -> None:
    """Push the finger down by a millimeter per frame, and slightly sideways."""
    for frame in frames:
        pose = at(0.0001 * frame, 0, start - 0.001 * (frame + 1))
        hand.set_bones(posed(hand.rig, pose))
        solver.step(FRAME)


def skin_of(solver: Solver, hand: Hand) -> np.ndarray:
    """The solver's vertices of a hand's skin [m], shape [V, 3]."""
    (soft,) = [soft for soft in solver._hands if soft.hand is hand]
    return hand.rig.carried_vertices(soft.flesh.data.position.numpy())


def test_a_scene_without_hands_allocates_nothing_for_them():
    """Allocate no arrays for hands, and list none."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING), Material())
    box = trimesh.creation.box((0.1, 0.1, 0.01))
    scene.add_mesh(box.vertices - (0, 0, 0.01), box.faces)
    solver = Solver(scene)
    assert solver._hands == []
    slots = solver._contacts.slots
    for name in ("compliance", "borne", "held", "lean", "face", "place"):
        assert getattr(slots, name).size == 0
    assert "hand" not in solver.describe()
    assert not any(name.startswith("hand") for name in solver.snapshot())


def test_describe_lists_hands(rig: HandRig):
    """List the flesh and its contact."""
    scene, _ = over_a_block(rig)
    text = Solver(scene).describe()
    assert f"{len(rig.nodes)} nodes" in text
    assert "contact with 1 hands" in text


def test_same_steps_give_the_same_bits(rig: HandRig):
    """Repeat a run exactly, including deflected bones."""
    results = []
    for _ in range(2):
        scene, hand = over_a_block(rig, hold_stiffness=300.0)
        solver = Solver(scene)
        press(solver, hand, 0.031, range(10))
        results.append((solver.positions(), solver.contacts(hand).forces))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


@pytest.mark.parametrize("hold_stiffness", [None, 300.0])
def test_snapshot_restores_hands_exactly(rig: HandRig, hold_stiffness: float | None):
    """Continue from a snapshot with the same bits as an uninterrupted run."""
    scene, hand = over_a_block(rig, hold_stiffness=hold_stiffness)
    solver = Solver(scene)
    press(solver, hand, 0.031, range(6))
    state = solver.snapshot()
    press(solver, hand, 0.031, range(6, 12))
    scene, other = over_a_block(rig, hold_stiffness=hold_stiffness)
    resumed = Solver(scene)
    resumed.restore(state)
    press(resumed, other, 0.031, range(6, 12))
    np.testing.assert_array_equal(resumed.positions(), solver.positions())
    np.testing.assert_array_equal(resumed.contacts(other).forces, solver.contacts(hand).forces)
    np.testing.assert_array_equal(skin_of(resumed, other), skin_of(solver, hand))


def test_hands_of_other_scenes_are_refused(rig: HandRig):
    """Say that the hand is not in the scene."""
    scene, _ = over_a_block(rig)
    solver = Solver(scene)
    stranger = Scene().add_hand(rig)
    with pytest.raises(ValueError, match="not in the scene"):
        solver.contacts(stranger)
    with pytest.raises(ValueError, match="not in the scene"):
        solver.force_on(stranger)


def test_the_papers_model_refuses_hands(rig: HandRig):
    """Refuse hands with a model that has no contact with them."""
    scene, _ = over_a_block(rig)
    with pytest.raises(ValueError, match="plastic_bonds"):
        Solver(scene, Settings(model="paper"))


def test_a_hand_needs_no_clay(rig: HandRig):
    """Move and jump in a scene without clay."""
    scene = Scene(SPACING)
    hand = scene.add_hand(rig)
    solver = Solver(scene)
    for x in (0.01, 0.5):
        hand.set_bones(posed(rig, at(x, 0, 0)))
        solver.step(FRAME)
        np.testing.assert_allclose(
            skin_of(solver, hand), rig.vertices + np.array((x, 0, 0)), atol=1e-5
        )
    assert solver.force_on(hand).tolist() == [0.0, 0.0, 0.0]


def test_momentum_of_the_clay_changes_by_the_force_of_the_hand(rig: HandRig):
    """Push free clay, whose momentum equals the negative impulse on the ghosts."""
    scene = Scene(SPACING, gravity=(0, 0, 0))
    scene.add_clay(block(5, SPACING), Material())
    hand = scene.add_hand(rig)
    hand.set_bones(posed(rig, at(0, 0, 0.0262)))
    solver = Solver(scene)
    given = np.zeros(3)
    for frame in range(15):
        hand.set_bones(posed(rig, at(0.0002 * frame, 0, 0.0262 - 0.001 * frame)))
        solver.step(FRAME)
        given -= solver.contacts(hand).forces.sum(0) * FRAME
    mass = 1700 * SPACING**3
    momentum = mass * solver.velocities().astype(float).sum(0)
    assert momentum[2] < -0.002
    np.testing.assert_allclose(momentum, given, atol=1e-4 * np.linalg.norm(momentum))


@pytest.mark.parametrize("hold_stiffness", [None, 500.0])
def test_a_block_on_an_open_palm_weighs_m_g(palm: HandRig, hold_stiffness: float | None):
    """Press with its weight on rigid and on yielding bones, until it sleeps."""
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING, (0.001, 0.002, 0.0002)), Material())
    hand = scene.add_hand(palm, hold_stiffness=hold_stiffness)
    solver = Solver(scene)
    forces = []
    for _ in range(75):
        solver.step(FRAME)
        forces.append(solver.force_on(hand))
    weight = 125 * 1700 * SPACING**3 * 9.81
    assert np.mean(forces[-15:], axis=0) == pytest.approx((0.0, 0.0, -weight), abs=0.02 * weight)
    assert solver.diagnostics().awake == 0


def test_clay_that_sleeps_on_a_palm_falls_when_the_hand_is_lost(palm: HandRig):
    """Wake clay that rested on a hand when the hand is lost."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING, (0.001, 0.002, 0.0)), Material())
    hand = scene.add_hand(palm)
    solver = Solver(scene)
    for _ in range(60):
        solver.step(FRAME)
    assert solver.diagnostics().awake == 0
    assert solver.force_on(hand)[2] < 0.0
    hand.set_tracked(False)
    before = solver.positions()[:, 2].mean()
    for _ in range(12):
        solver.step(FRAME)
    fallen = before - solver.positions()[:, 2].mean()
    assert fallen == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.03)
    assert not solver.force_on(hand).any()


@pytest.mark.parametrize("hold_stiffness", [None, 500.0])
def test_two_hands_that_squeeze_a_block_feel_the_same(palm: HandRig, hold_stiffness: float | None):
    """Squeeze a free block with equal and opposite forces, without moving its center."""
    scene = Scene(SPACING, gravity=(0, 0, 0))
    scene.add_clay(block(6, SPACING, (0, 0, -0.015)), Material())
    hands = [scene.add_hand(palm, hold_stiffness=hold_stiffness) for _ in range(2)]
    turns = [trimesh.transformations.rotation_matrix(a, (0, 1, 0)) for a in (np.pi / 2, -np.pi / 2)]

    def close(apart: float) -> None:
        for hand, turn, side in zip(hands, turns, (-1, 1), strict=True):
            hand.set_bones(posed(palm, at(side * apart, 0, 0) @ turn))

    close(0.0155)
    solver = Solver(scene)
    for frame in range(30):
        close(0.0155 - 0.0003 * min(frame, 20))
        solver.step(FRAME)
    left, right = (solver.force_on(hand) for hand in hands)
    assert left[0] < -2.0
    np.testing.assert_allclose(left, -right, atol=0.01 * abs(left[0]))
    assert np.abs(solver.positions().mean(0)).max() < 0.1 * SPACING


def test_stiff_clay_stops_a_yielding_finger_and_soft_clay_lets_it_through(rig: HandRig):
    """Track a finger held by 200 N/m 12 mm into clay of 1 kPa and of 50 kPa."""
    depths, forces = [], []
    for yield_stress, shear_modulus in ((1e3, 1e5), (5e4, 2e6)):
        material = Material(yield_stress=yield_stress, shear_modulus=shear_modulus, viscosity=50.0)
        scene, hand = over_a_block(rig, hold_stiffness=200.0, material=material)
        solver = Solver(scene)
        for frame in range(45):
            hand.set_bones(posed(rig, at(0, 0, 0.031 - min(0.001 * frame, 0.013))))
            solver.step(FRAME)
        depths.append(0.030 - skin_of(solver, hand)[:, 2].min())
        forces.append(float(solver.force_on(hand)[2]))
    soft, stiff = depths
    assert soft > 0.008
    assert stiff < 0.002
    assert forces[1] > 2.0 * forces[0]
    # Along a straight finger only the root yields, with a quarter of the total compliance.
    assert forces[1] < 4.0 * 200.0 * 0.012


def test_a_yielding_finger_returns_to_its_pose_after_release(rig: HandRig):
    """Lift a deflected finger off the clay, and find it in its tracked pose."""
    scene, hand = over_a_block(rig, hold_stiffness=100.0)
    solver = Solver(scene)
    press(solver, hand, 0.031, range(12))
    assert skin_of(solver, hand)[:, 2].min() > 0.021
    for frame in range(30):
        hand.set_bones(posed(rig, at(0, 0, 0.02 + 0.01 * min(frame, 20))))
        solver.step(FRAME)
    expected = rig.vertices + np.array((0, 0, 0.22))
    np.testing.assert_allclose(skin_of(solver, hand), expected, atol=2e-5)


def test_bones_keep_their_poses_unless_they_may_yield(rig: HandRig):
    """Keep the root of the flesh in place, however hard clay pushes."""
    scene, hand = over_a_block(rig, material=Material(yield_stress=5e4, shear_modulus=2e6))
    solver = Solver(scene)
    press(solver, hand, 0.031, range(8))
    high = rig.vertices[:, 2] > 0.045
    expected = rig.vertices[high] + np.array((0.0007, 0, 0.023))
    assert solver.force_on(hand)[2] > 5.0
    np.testing.assert_allclose(skin_of(solver, hand)[high], expected, atol=2e-3)


@pytest.mark.parametrize(("young_modulus", "growth"), [(5e4, (1.8, 4.0)), (1e7, (0.9, 1.2))])
def test_a_fingertip_flattens_on_stiff_clay(
    rig: HandRig, young_modulus: float, growth: tuple[float, float]
):
    """Flatten at least 1.8 times the skin area of a fingertip at rest, if the flesh is soft."""
    fine = 0.0025
    top = 6 * fine
    scene = Scene(fine)
    scene.add_clay(
        block((12, 12, 6), fine), Material(yield_stress=1e6, shear_modulus=1e7, density=2000.0)
    )
    scene.add_plane()
    hand = scene.add_hand(rig, young_modulus=young_modulus)
    hand.set_bones(posed(rig, at(0, 0, top + 0.001)))
    solver = Solver(scene)
    for frame in range(24):
        hand.set_bones(posed(rig, at(0, 0, top + 0.001 - 0.0003 * min(frame, 13))))
        solver.step(FRAME)

    def flat(height: np.ndarray) -> float:
        return float(rig.ghost_areas[height < height.min() + 0.0005].sum())

    before = flat(rig.carried_ghosts(rig.nodes)[:, 2])
    now = flat(solver.contacts(hand).positions[:, 2])
    assert growth[0] < now / before < growth[1]


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_a_fast_finger_does_not_tunnel(rig: HandRig, speed: float):
    """Sweep through a block: no clay stays in the flesh, none is faster than twice the finger."""
    scene, hand = over_a_block(rig, (6, 8, 6))
    solver = Solver(scene)
    x = -0.045
    hand.set_bones(posed(rig, at(x, 0, 0.012)))
    solver.step(FRAME)
    fastest = 0.0
    while x < 0.04:
        x = min(x + speed * FRAME, 0.04)
        hand.set_bones(posed(rig, at(x, 0, 0.012)))
        solver.step(FRAME)
        fastest = max(fastest, solver.diagnostics().max_speed)
        inside = is_inside(skin_of(solver, hand), rig.faces, solver.positions())
        assert inside.sum() <= 1
    assert not inside.any()
    assert solver.diagnostics().teleported == 0
    assert fastest < 2.0 * speed


def test_a_hand_that_jumps_into_clay_moves_it_out_gently_and_feels_nothing_meanwhile(rig: HandRig):
    """Push clay out at no more than 0.5 m/s, and report forces only afterwards."""
    scene, hand = over_a_block(rig)
    solver = Solver(scene)
    solver.step(FRAME)
    before = solver.positions().mean(0)
    hand.set_bones(posed(rig, at(0.3, 0, 0.5)))
    solver.step(FRAME)
    hand.set_bones(posed(rig, at(0, 0, 0.018)))
    fastest = 0.0
    for frame in range(30):
        solver.step(FRAME)
        fastest = max(fastest, solver.diagnostics().max_speed)
        if frame < 10:
            assert not solver.contacts(hand).forces.any()
    assert solver.diagnostics().teleported == 2
    assert fastest < 0.5
    assert not is_inside(skin_of(solver, hand), rig.faces, solver.positions()).any()
    assert solver.force_on(hand)[2] > 0.1
    assert np.abs(solver.positions().mean(0) - before).max() < 0.2 * SPACING


def test_a_hand_that_jumps_away_moves_no_clay(rig: HandRig):
    """Leave the clay in place."""
    scene, hand = over_a_block(rig)
    solver = Solver(scene)
    press(solver, hand, 0.031, range(10))
    before = solver.positions()
    hand.set_bones(posed(rig, at(0, 0.3, 0.4)))
    for _ in range(10):
        solver.step(FRAME)
    assert np.abs(solver.positions() - before).max() < 0.5 * SPACING
    assert not solver.contacts(hand).forces.any()


def test_a_lost_hand_touches_nothing_and_regains_its_grip_gradually(rig: HandRig):
    """Release clay at once, reappear inside clay gently, and report forces once clay is outside."""
    scene, hand = over_a_block(rig)
    solver = Solver(scene)
    press(solver, hand, 0.031, range(8))
    assert solver.force_on(hand)[2] > 1.0
    hand.set_tracked(False)
    hand.set_bones(posed(rig, at(0, 0, -1.0)))
    for _ in range(10):
        solver.step(FRAME)
        assert not solver.contacts(hand).forces.any()
    np.testing.assert_allclose(
        skin_of(solver, hand), rig.vertices + np.array((0.0007, 0, 0.023)), atol=1e-5
    )
    hand.set_bones(posed(rig, at(0.005, 0, 0.02)))
    hand.set_tracked(True)
    fastest = 0.0
    for frame in range(25):
        solver.step(FRAME)
        fastest = max(fastest, solver.diagnostics().max_speed)
        if frame < 10:
            assert not solver.contacts(hand).forces.any()
    assert fastest < 0.5
    assert solver.force_on(hand)[2] > 0.1


def test_flesh_recovers_from_a_jump_within_half_a_second(rig: HandRig):
    """Return to shape within 0.5 s after the pose jumped by 18 cm and bent by 80°."""
    scene = Scene(SPACING)
    hand = scene.add_hand(rig)
    solver = Solver(scene)
    bent = posed(rig, at(0, 0, 0))
    turn = trimesh.transformations.rotation_matrix(1.4, (1, 0, 0), rig.bone_rest[1, :3, 3])
    for name in ("bone_1", "bone_2"):
        bent[name] = turn @ bent[name]
    hand.set_bones(bent)
    for _ in range(60):
        solver.step(FRAME)
    settled = skin_of(solver, hand)
    hand.set_bones(posed(rig, at(0, 0, 0)))
    for _ in range(30):
        solver.step(FRAME)
    hand.set_bones({name: at(0.1, 0.1, 0.11) @ pose for name, pose in bent.items()})
    for _ in range(30):
        solver.step(FRAME)
    np.testing.assert_allclose(
        skin_of(solver, hand), settled + np.array((0.1, 0.1, 0.11)), atol=5e-4
    )


@pytest.mark.parametrize(
    ("hold_stiffness", "shift", "turn"),
    [(None, 0.002, 0.1), (300.0, 0.002, 0.1), (300.0, 0.1, 3.0)],
)
def test_noisy_and_erratic_tracking_is_tolerated(
    rig: HandRig, hold_stiffness: float | None, shift: float, turn: float
):
    """Stay finite, and keep the clay together, for any motion of the bones."""
    scene, hand = over_a_block(rig, hold_stiffness=hold_stiffness)
    solver = Solver(scene)
    random = np.random.default_rng(0)
    fastest = 0.0
    for frame in range(30):
        middle = at(0, 0, 0.031 - 0.001 * min(frame, 12))
        bones = {}
        for name, pose in posed(rig, middle).items():
            shaken = trimesh.transformations.euler_matrix(*random.normal(0, turn, 3))
            shaken[:3, 3] = random.normal(0, shift, 3)
            bones[name] = pose @ shaken
        hand.set_bones(bones)
        solver.step(FRAME)
        fastest = max(fastest, solver.diagnostics().max_speed)
    assert np.isfinite(skin_of(solver, hand)).all()
    assert np.isfinite(solver.contacts(hand).forces).all()
    assert fastest < 2.5
    assert np.abs(solver.positions()).max() < 0.1
    assert solver.diagnostics().quarantined == 0
