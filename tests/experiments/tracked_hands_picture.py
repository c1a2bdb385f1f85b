# SPDX-License-Identifier: GPL-3.0-or-later
"""A contact sheet of a recording: both hands as they would be shown, on rigs of fixed lengths.

    python -m tactile_clay.tests.experiments.tracked_hands_picture RECORDING --output sheet.png

Hands are drawn by their joints and radii, brown where live, blue where held and red where lost; the
tracker's own joints are drawn over them.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_clay.clay_addon.core.tracking.hand.presence import TrackedHand
from tactile_clay.clay_addon.core.tracking.hand.retarget import Z_UP, HandTarget
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    FINGERS,
    JOINT_NAMES,
    PARENTS,
    WRIST,
    reference_hand,
)
from tactile_clay.clay_addon.core.tracking.recording.recording import read_recording
from tactile_clay.clay_addon.core.tracking.recording.resample import resampled_hands

Array = NDArray[np.float64]

COLORS = {"live": (0.85, 0.65, 0.5), "held": (0.5, 0.55, 0.85), "lost": (0.85, 0.35, 0.3)}
ROWS, COLUMNS = 3, 4
LIGHT = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])


def reference_target(side: str) -> HandTarget:
    """A rig with the reference hand's proportions."""
    reference = reference_hand(side)
    bones = {}
    for number, name in enumerate(JOINT_NAMES):
        matrix = np.eye(4)
        matrix[:3, :3] = Z_UP @ reference.rotations[number]
        matrix[:3, 3] = Z_UP @ reference.positions[number]
        bones[name] = matrix
    return HandTarget(bones, side)


def round_cone(start: Array, end: Array, first: float, second: float) -> Array:
    """Triangles of a bone: a cone with round ends [m], shape [T, 3, 3]."""
    axis = end - start
    axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    around = np.linspace(0.0, 2.0 * np.pi, 11)
    ring = np.outer(np.cos(around), side) + np.outer(np.sin(around), np.cross(axis, side))
    rows = []
    for middle, radius, angles in ((start, first, (-90, -45, 0)), (end, second, (0, 45, 89))):
        for angle in np.radians(angles):
            rows.append(middle + radius * (np.cos(angle) * ring + np.sin(angle) * axis))
    grid = np.array(rows)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)


def hand_triangles(target: HandTarget, hand: TrackedHand) -> Array:
    """Triangles of a hand's bones, posed on the rig [m], shape [T, 3, 3]."""
    posed = target.posed(hand.positions, hand.quaternions, hand.valid)
    places = np.array([posed[name][:3, 3] for name in JOINT_NAMES])
    radii = reference_hand(target.side).radii
    bones = [(joint, PARENTS[joint]) for finger in FINGERS for joint in finger]
    # The palm: between the bases, and between the heads, of the metacarpals.
    bones += [(6, 11), (11, 16), (16, 21), (7, 12), (12, 17), (17, 22), (2, 6)]
    return np.concatenate(
        [round_cone(places[b], places[a], float(radii[b]), float(radii[a])) for a, b in bones]
    )


def draw(
    axes: Any, hands: Sequence[TrackedHand], targets: dict[str, HandTarget], title: str
) -> None:
    """Draw the hands at one time."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    everything = []
    for hand in hands:
        triangles = hand_triangles(targets[hand.side], hand)
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.linalg.norm(normals, axis=1)[:, None] + 1e-12
        shade = 0.4 + 0.6 * np.abs(normals @ LIGHT)
        colors = np.clip(shade[:, None] * COLORS[hand.state], 0.0, 1.0)
        axes.add_collection3d(Poly3DCollection(triangles, facecolors=colors, edgecolors="none"))
        seen = hand.positions @ Z_UP.T
        for finger in FINGERS:
            axes.plot(*seen[[WRIST, *finger]].T, "k.-", linewidth=0.6, markersize=2, zorder=99)
        everything.append(triangles.reshape(-1, 3))
    axes.set_title(title, fontsize=8)
    axes.set_axis_off()
    axes.view_init(elev=30, azim=-80)
    if everything:
        points = np.concatenate(everything)
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = max(0.1, 0.45 * float(np.ptp(points, axis=0).max()))
        for name, value in zip("xyz", middle, strict=True):
            getattr(axes, f"set_{name}lim")(value - reach, value + reach)


def contact_sheet(recording: Path, output: Path) -> None:
    """Draw a recording at twelve times into a picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    entries = read_recording(recording)
    count = ROWS * COLUMNS
    times = [round(0.98 * entries[-1].time * number / (count - 1)) for number in range(count)]
    hands = resampled_hands(entries, times)
    targets = {side: reference_target(side) for side in hands}
    figure = plt.figure(figsize=(3.2 * COLUMNS, 3.2 * ROWS))
    for number, time in enumerate(times):
        axes = figure.add_subplot(ROWS, COLUMNS, number + 1, projection="3d")
        present = [hand for side in hands if (hand := hands[side][number]) is not None]
        words = [f"{hand.side} {hand.state} {hand.contact:.0%}" for hand in present]
        draw(axes, present, targets, f"{time * 1e-9:.2f} s: " + (", ".join(words) or "no hand"))
    figure.tight_layout()
    figure.savefig(output, dpi=80)
    plt.close(figure)


def main() -> None:
    """Draw the recording named on the command line."""
    parser = argparse.ArgumentParser(description="Draw a contact sheet of a recording of hands.")
    parser.add_argument("recording", type=Path, help="a recording, or a Leap's .json.gz")
    parser.add_argument("--output", type=Path, default=Path("build/tracked_hands.png"))
    options = parser.parse_args()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    contact_sheet(options.recording, options.output)
    print(options.output)


if __name__ == "__main__":
    main()
