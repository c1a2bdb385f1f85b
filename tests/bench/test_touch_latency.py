# SPDX-License-Identifier: GPL-3.0-or-later
"""Latency is measured over the whole path from contact to wire."""

import sys

import numpy as np
import pytest

from tactile_clay.tests.bench import touch_latency, touch_silence
from tactile_clay.tests.haptics.peers.harness import TWO_FOCI, peer


def test_latency_counts_from_the_contact_forces() -> None:
    """Include the time of the focal points, the server and the wire."""
    slow = 0.03

    def next_foci(frame: int) -> object:
        import time

        time.sleep(slow)
        return TWO_FOCI

    figures = touch_latency.measure_device("simulated:openmpd", next_foci, frames=25)
    assert figures["focus_ms"] >= 1e3 * slow
    assert figures["latency_ms"] >= 1e3 * slow
    assert figures["latency_p99_ms"] >= figures["latency_ms"]
    assert figures["frames_per_second"] > 0
    assert "frames/s" in touch_latency.sentence({"case": "x"} | figures)


@pytest.mark.skipif(sys.platform == "win32", reason="a pty is needed")
def test_the_wire_counts() -> None:
    """Include the 11 ms that 258 bytes take on a wire at 230,400 baud."""
    with touch_latency.drained_port() as port:
        figures = touch_latency.measure_device(
            f"sonicsurface:{port},firmware=tactile", lambda frame: TWO_FOCI, frames=25
        )
    assert figures["latency_ms"] >= 11.0


def test_the_palm_is_pressed_above_the_array() -> None:
    """Press 2,000 ghosts that face the array with tens of kilopascals."""
    contacts = touch_latency.palm_contacts(3)
    assert len(contacts.positions) == touch_latency.GHOSTS
    pressure = -np.einsum("gi,gi->g", contacts.normals, contacts.forces) / contacts.areas
    assert 2e4 < pressure.max() < 5e4
    assert (contacts.normals[:, 2] < 0.0).all()


@pytest.mark.skipif(sys.platform == "win32", reason="a pty is needed")
def test_silence_is_timed_from_its_cause() -> None:
    """Include the 150 ms for which data stay valid, but not when silence is requested."""
    with peer("sonicsurface_peer", "tactile", "1") as board:
        slow = touch_silence.time_to_silence(board, touch_silence.ENDS["no more data"])
        fast = touch_silence.time_to_silence(board, touch_silence.ENDS["no focal points"])
    assert slow > 0.12
    assert fast < slow
