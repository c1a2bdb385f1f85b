# SPDX-License-Identifier: GPL-3.0-or-later
"""LeapC through ctypes, tested with a C library that has the documented structures."""

import ctypes
import shutil
import subprocess
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.protocol.packet import encode
from tactile_clay.clay_addon.core.tracking.sources.leapc import (
    LeapHand,
    Message,
    TrackingEvent,
    leapc,
    load_library,
)
from tactile_clay.solver.geometry.rotations import angles_between
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, flat_hand

PLACES = {"left": (-0.1, 0.2, 0.0), "right": (0.1, 0.2, 0.0)}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled library, with the joints of two hands."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    path = tmp_path_factory.mktemp("leapc") / "libLeapC.so"
    source = Path(__file__).with_name("fake_leapc.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", path, source], check=True)
    joints = (ctypes.c_float * (2 * 26 * 3)).in_dll(ctypes.CDLL(str(path)), "joints")
    both = [flat_hand(side, PLACES[side])[:, :3] * 1000.0 for side in ("left", "right")]
    joints[:] = np.array(both).ravel().tolist()
    return path


def test_structures_have_the_documented_sizes() -> None:
    """Lay out the structures without padding, which would shift all fields after it."""
    assert ctypes.sizeof(LeapHand) == 1084
    assert ctypes.sizeof(TrackingEvent) == 48
    assert TrackingEvent.hands.offset == 36
    assert ctypes.sizeof(Message) == 20


def test_hands_are_read_from_the_library(library: Path) -> None:
    """Read both hands at the time they were seen, with wrist, metacarpals and widths."""
    now = 50_000 * MILLISECOND
    messages: list[str] = []
    stream = leapc(str(library), clock=lambda: now, report=messages.append)
    first, both, corrupt, silent = islice(stream, 4)
    stream.close()
    assert set(first.absent) == set(silent.absent) == {"left", "right"}
    assert messages == ["Connected to the Ultraleap service.", "A tracking device is connected."]
    assert [frame.side for frame in both.frames] == ["right", "left"]
    for frame in both.frames:
        expected = flat_hand(frame.side, PLACES[frame.side])
        assert frame.source_time == now - 10 * MILLISECOND
        assert np.allclose(frame.positions, expected[:, :3], atol=1e-5)
        assert np.degrees(angles_between(frame.quaternions, expected[:, 3:7])).max() < 0.3
        assert frame.radii[8] == pytest.approx(0.009)
        encode(frame)
    # A hand with a bone of zero length is skipped, the other one is not.
    assert [frame.side for frame in corrupt.frames] == ["left"]


def test_missing_or_wrong_library_is_explained(tmp_path: Path) -> None:
    """Say what was tried and what to do."""
    with pytest.raises(TrackingError, match=r"Install Ultraleap.*--library"):
        load_library(str(tmp_path / "libLeapC.so"))
    (tmp_path / "libLeapC.so").write_text("no library")
    with pytest.raises(TrackingError, match="cannot be loaded"):
        load_library(str(tmp_path / "libLeapC.so"))
