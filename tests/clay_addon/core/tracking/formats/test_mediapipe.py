# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of MediaPipe's landmarks to hands in space."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking.formats.mediapipe import MediapipeHands
from tactile_clay.clay_addon.core.tracking.protocol.joints import FINGERS, WRIST
from tactile_clay.clay_addon.core.tracking.protocol.packet import encode
from tactile_clay.solver.geometry.rotations import angles_between
from tactile_clay.tests.clay_addon.core.tracking.hands import flat_hand

LANDMARKS = [WRIST, *(joint for finger in FINGERS for joint in finger[-4:])]
WIDTH, HEIGHT, VIEW = 1280, 720, 70.0
# Half a meter in front of the camera, fingers up, palm towards the camera.
UP = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
WRIST_POSITION = (0.06, -0.08, 0.5)


def entry(side: str, hand: np.ndarray, *, mirrored: bool = False, score: float = 0.9) -> dict:
    """MediaPipe's result for a hand in a pinhole camera's image."""
    # The camera faces the user: its axes point right, down and away.
    points = hand[LANDMARKS, :3].astype(float) * [-1.0, -1.0, 1.0]
    focal = 0.5 / math.tan(math.radians(VIEW) / 2.0)
    image = points[:, :2] / points[:, 2:] * focal * [1.0, WIDTH / HEIGHT] + 0.5
    world = points - points.mean(axis=0)
    if mirrored:
        side = {"left": "right", "right": "left"}[side]
        image[:, 0] = 1.0 - image[:, 0]
        world[:, 0] *= -1.0
    return {
        "side": side.capitalize(),
        "score": score,
        "image": image.tolist(),
        "world": world.tolist(),
    }


def line(*entries: Any, **changes: Any) -> str:
    """The worker's line for an image."""
    record = {"time": 42, "width": WIDTH, "height": HEIGHT, "hands": list(entries)}
    return json.dumps(record | changes)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_hand_is_placed_in_front_of_the_camera(side: str, mirrored: bool) -> None:
    """Find position and pose of a hand from a pinhole camera's image, mirrored or not."""
    hand = flat_hand(side, WRIST_POSITION, quaternion=UP)
    reader = MediapipeHands(field_of_view=VIEW, mirrored=mirrored)
    (frame,) = reader.read(line(entry(side, hand, mirrored=mirrored)))
    assert (frame.side, frame.source, frame.source_time) == (side, "mediapipe", 42)
    assert frame.confidence == pytest.approx(0.9)
    assert np.allclose(frame.positions[1:], hand[1:, :3], atol=2e-4)
    assert np.degrees(angles_between(frame.quaternions, hand[:, 3:7])).max() < 0.5


def test_hand_estimated_smaller_is_placed_nearer() -> None:
    """Place a hand of half the estimated size at half the distance, so that it fits the image."""
    hand = flat_hand("right", WRIST_POSITION, quaternion=UP)
    seen = entry("right", hand)
    seen["world"] = (0.5 * np.array(seen["world"])).tolist()
    (frame,) = MediapipeHands(field_of_view=VIEW).read(line(seen))
    assert frame.positions[WRIST, 2] == pytest.approx(0.25, abs=0.01)


def test_of_two_hands_of_a_side_the_more_confident_is_kept() -> None:
    """Return at most one hand per side."""
    hand = flat_hand("right", WRIST_POSITION, quaternion=UP)
    other = flat_hand("right", (-0.1, 0.0, 0.6), quaternion=UP)
    seen = line(entry("right", other, score=0.6), entry("right", hand, score=0.95))
    (frame,) = MediapipeHands(field_of_view=VIEW).read(seen)
    assert frame.positions[WRIST, 0] == pytest.approx(0.06, abs=1e-3)


GOOD = entry("right", flat_hand("right", WRIST_POSITION, quaternion=UP))


@pytest.mark.parametrize(
    "bad",
    [
        "",
        "{",
        "[]",
        line(time=-1),
        line(width=0),
        line(hands=3),
        line(3),
        line({**GOOD, "side": "Both"}),
        line({**GOOD, "image": [[0, 0]] * 20}),
        line({**GOOD, "world": [[0, 0, 0]] * 21}),
        line({**GOOD, "world": [[float("nan")] * 3] * 21}),
        line({**GOOD, "score": None}),
        line({**GOOD, "image": [[0.5 - 1e-6 * n, 0.5] for n in range(21)]}),
        "[" * 50_000,
    ],
)
def test_invalid_line_is_counted(bad: str) -> None:
    """Count invalid images and hands."""
    reader = MediapipeHands()
    assert reader.read(bad) == []
    assert reader.rejected == 1


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.characters(max_codepoint=127)), max_size=8))
def test_corrupt_lines_give_only_valid_hands(changes) -> None:
    """Return only hands that can be sent."""
    text = list(line(GOOD))
    for place, character in changes:
        text[int(place * (len(text) - 1))] = character
    for frame in MediapipeHands().read("".join(text)):
        encode(frame)
