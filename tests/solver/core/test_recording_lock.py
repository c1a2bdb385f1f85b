# SPDX-License-Identifier: GPL-3.0-or-later
"""What the recording lock protects against."""

import threading

import numpy as np
import warp as wp

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.core.recording import Recordings
from tactile_clay.solver.core.recording_lock import recording_lock
from tactile_clay.tests.experiments.shapes import block

SIZE = 64
LAUNCHES = 20


@wp.kernel(enable_backward=False)
def add_one(values: wp.array[float]) -> None:
    """Count launches."""
    i = wp.tid()
    values[i] = values[i] + 1.0


def counter() -> wp.array:
    """An array of zeros on the CPU."""
    return wp.zeros(SIZE, dtype=float, device="cpu")


def test_a_capture_is_in_force_on_all_threads() -> None:
    """See another thread's capture; once Warp no longer does that, the lock can go."""
    seen = []
    values = counter()
    wp.launch(add_one, dim=SIZE, inputs=[values], device="cpu")
    with recording_lock, wp.ScopedCapture(device="cpu"):
        wp.launch(add_one, dim=SIZE, inputs=[values], device="cpu")
        other = threading.Thread(target=lambda: seen.append(wp.get_device("cpu").is_capturing))
        other.start()
        other.join()
    assert seen == [True]


def test_threads_that_hold_the_lock_work_beside_recordings() -> None:
    """Launch and allocate on one thread while another records, with correct results on both."""
    scene = Scene(0.005)
    scene.add_clay(block(2, 0.005), Material())
    recordings = Recordings(Solver(scene)._particles, by_part=False)
    recorded, beside = counter(), counter()
    launches, wrong, ended = 0, 0, threading.Event()
    errors: list[Exception] = []

    def work() -> None:
        nonlocal launches, wrong
        try:
            while not ended.is_set():
                with recording_lock:
                    wp.launch(add_one, dim=SIZE, inputs=[beside], device="cpu")
                    ones = wp.array(np.ones(SIZE), dtype=float, device="cpu")
                    wrong += not (ones.numpy() == 1.0).all()
                launches += 1
        except Exception as error:
            errors.append(error)

    def launch() -> None:
        for _ in range(LAUNCHES):
            wp.launch(add_one, dim=SIZE, inputs=[recorded], device="cpu")

    other = threading.Thread(target=work)
    other.start()
    rounds = 100
    try:
        for number in range(rounds):
            recordings.run(number, launch)
            recordings.run(number, launch)
    finally:
        ended.set()
        other.join()
    assert not errors
    assert not wrong
    assert launches > 0
    np.testing.assert_array_equal(recorded.numpy(), 2.0 * rounds * LAUNCHES)
    np.testing.assert_array_equal(beside.numpy(), float(launches))


def test_a_solver_that_still_steps_does_not_harm_the_next_one() -> None:
    """An ended session finishes its step on its own thread while the next solver is made."""

    def scene() -> Scene:
        made = Scene(0.005)
        made.add_clay(block(6, 0.005), Material())
        made.add_plane()
        return made

    known = Solver(scene())
    for _ in range(6):
        known.step()
    expected = known.positions()
    errors: list[Exception] = []

    def step(solver: Solver) -> None:
        try:
            # The first step of a length launches, the second records, the third replays.
            for _ in range(6):
                solver.step()
        except (RuntimeError, AttributeError) as error:
            errors.append(error)

    for _ in range(25):
        first = Solver(scene())
        running = threading.Thread(target=step, args=(first,))
        running.start()
        second = Solver(scene())
        step(second)
        running.join()
        for solver in (first, second):
            np.testing.assert_array_equal(solver.positions(), expected)
    assert not errors
