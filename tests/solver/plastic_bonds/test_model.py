# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of contacts and particles for the CPU against the plain kernels, from pressed clay."""

from collections.abc import Callable

import numpy as np
import warp as wp

from tactile_clay.solver.contact import law as contact_law
from tactile_clay.solver.contact import passes_cpu
from tactile_clay.solver.contact import search as contact_search
from tactile_clay.solver.core import particles, particles_cpu
from tactile_clay.solver.core.particles import ByPart
from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.tests.solver.plastic_bonds.two_ways import (
    compare,
    over_parts,
    per_particle,
)

SPACING = 0.005
STEP = 1 / 240


def test_contacts_are_found_the_same(pressed: PlasticBonds):
    """Find the same contacts with and without screening by block."""
    body, contacts = pressed.particles, pressed.contacts
    slots, around = contacts.slots, contacts._surroundings
    common = contact_law.ContactPass()
    common.time_step = common.time_step_before = STEP
    common.radius, common.margin = 0.5 * SPACING, contact_law.MARGIN * SPACING
    inputs = [common, around, body.position, body.velocity, slots]
    compare(
        pressed,
        lambda: body.launch(contact_search.find_all_contacts, *inputs),
        lambda: body.launch_blocks(passes_cpu.find_all_contacts, *inputs, contacts._near),
        [slots.count, slots.collider, slots.anchor, around.clearance],
        per_particle(slots.count, slots.gap, slots.normal, around.clearance),
    )


def test_particles_fall_and_move_the_same(pressed: PlasticBonds):
    """Fall, move, clamp and quarantine particles alike."""
    body = pressed.particles
    body.speed_limit.fill_(0.1)
    velocity = np.random.default_rng(6).normal(size=(body.count, 3)).astype(np.float32) * 0.05
    velocity[7] = np.nan
    velocity[9, 1] = np.inf
    kept = body.velocity.numpy().copy()
    body.velocity.assign(velocity)
    kick = wp.vec3(0.0, 0.0, -0.04)

    def run(module: object, launch: Callable[..., None]) -> None:
        counts = [ByPart.rows(body.clamped), ByPart.rows(body.quarantined)]
        if module is particles:
            counts = [own[0] for own in counts]
        motion = [body.velocity, body.velocity_free]
        launch(module.fall_freely, kick, *motion, counts[1])  # type: ignore[attr-defined]
        moved = [body.velocity, body.position, body.speed_limit]
        launch(module.move, STEP, *moved, *counts)  # type: ignore[attr-defined]

    compare(
        pressed,
        lambda: run(particles, body.launch),
        lambda: run(particles_cpu, body.launch_blocks),
        [body.position, body.velocity, body.clamped, body.quarantined],
        per_particle(body.position, body.velocity, body.velocity_free)
        | over_parts(body.clamped, body.quarantined),
        tolerance=1e-6,
    )
    body.velocity.assign(kept)
