# SPDX-License-Identifier: GPL-3.0-or-later
"""Generate the meshes of the sculpting tools in ``presets/tools``; run this after changing a shape.

All are in the tool's local coordinates: the brush radius is 1, the point of contact with the clay
is at the origin, +Z points away from the clay, and +Y along the stroke.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parent.parent / "presets" / "tools"

Points = NDArray[np.float64]
Mesh = tuple[Points, NDArray[np.int64]]


def loft(rings: Sequence[Points], first: Points, last: Points) -> Mesh:
    """Connect a stack of rings, shape [N, 3] each, and close both ends with a fan to a point.

    Seen from the last point, the rings run counterclockwise.
    """
    count = len(rings[0])
    vertices = np.concatenate([first[None], *rings, last[None]])
    current = np.arange(count)
    following = (current + 1) % count
    end = len(vertices) - 1
    faces = [np.column_stack([np.zeros(count, int), 1 + following, 1 + current])]
    for ring in range(len(rings) - 1):
        low, high = 1 + ring * count, 1 + (ring + 1) * count
        faces.append(np.column_stack([low + current, low + following, high + following]))
        faces.append(np.column_stack([low + current, high + following, high + current]))
    top = 1 + (len(rings) - 1) * count
    faces.append(np.column_stack([top + current, top + following, np.full(count, end)]))
    return vertices, np.concatenate(faces)


def ring(outline: Points, height: float) -> Points:
    """An outline, shape [N, 2], at a height."""
    return np.column_stack([outline, np.full(len(outline), height)])


def circle(count: int, radius: float, *, squeeze: float = 1.0) -> Points:
    """A circle around the origin, scaled in y by `squeeze`, shape [N, 2]."""
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), squeeze * np.sin(angle)])


def rounded_square(count: int, half: tuple[float, float], power: float) -> Points:
    """A superellipse |x|^p + |y|^p = 1, scaled to half side lengths, shape [N, 2]."""
    unit = circle(count, 1.0)
    radius = (np.abs(unit) ** power).sum(1) ** (-1.0 / power)
    return unit * radius[:, None] * np.array(half)


def stacked(outline: Callable[[float], Points], profile: Sequence[tuple[float, float]]) -> Mesh:
    """Loft outlines along Z.

    Args:
        outline: Outline of a given size.
        profile: Pairs (size, height); the first and last size are 0.
    """
    rings = [ring(outline(size), height) for size, height in profile[1:-1]]
    poles = [np.array((0.0, 0.0, height)) for _, height in (profile[0], profile[-1])]
    return loft(rings, *poles)


def arc(center: tuple[float, float], radius: float, start: float, end: float, count: int) -> list:
    """Pairs (size, height) along an arc; angles in degrees above horizontal."""
    angle = np.radians(np.linspace(start, end, count))
    return [(center[0] + radius * np.cos(a), center[1] + radius * np.sin(a)) for a in angle]


def grip(radius: float, base: float, top: float) -> list[tuple[float, float]]:
    """Profile of a round handle from a base height, with a domed top."""
    waist = 0.8 * radius
    return [
        (radius, base),
        (waist, base + 0.3 * (top - base)),
        *arc((0.0, top - radius), radius, 0, 75, 4),
        (0.0, top),
    ]


def finger() -> Mesh:
    """A fingertip: rounded, slightly flattened front to back, with a straight shaft."""
    profile = [
        (0.0, 0.0),
        *arc((0.0, 1.0), 1.0, -80, 0, 8),
        (0.97, 2.0),
        (0.92, 3.4),
        *arc((0.0, 4.2), 0.9, 0, 72, 5),
        (0.0, 5.1),
    ]
    return stacked(lambda size: circle(28, size, squeeze=0.88), profile)


def palm() -> Mesh:
    """A broad cushion with a slightly convex underside and rounded edges."""
    sole = [(size, 0.06 * size**2) for size in (0.0, 0.28, 0.55, 0.78)]
    edge = arc((0.78, 0.26), 0.22, -75, 75, 7)
    back = [(0.55, 0.52), (0.28, 0.56), (0.0, 0.58)]
    return stacked(lambda s: rounded_square(36, (s, 0.9 * s), 3.0), [*sole, *edge, *back])


def ball() -> Mesh:
    """A ball stylus: a ball on a thin stem."""
    stem = 0.32
    join = np.degrees(np.arccos(stem))
    profile = [
        (0.0, 0.0),
        *arc((0.0, 1.0), 1.0, -80, join, 15),
        (stem, 2.4),
        (stem, 4.6),
        *arc((0.0, 4.6), stem, 20, 70, 3),
        (0.0, 4.6 + stem),
    ]
    return stacked(lambda size: circle(32, size), profile)


def lying(mesh: Mesh, height: float) -> Mesh:
    """Rotate a mesh from the Z axis to the X axis, and raise it to a height."""
    vertices, faces = mesh
    rotated = np.column_stack([vertices[:, 2], -vertices[:, 1], vertices[:, 0] + height])
    return rotated, faces


def mirrored(half: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """A profile symmetric about height 0, from its upper half."""
    return [*((size, -height) for size, height in reversed(half)), *half]


def rolling_pin() -> Mesh:
    """A cylinder across the stroke, with a handle at either end."""
    half = [
        (1.0, 0.8),
        (1.0, 2.4),
        *arc((0.85, 2.6), 0.15, 0, 80, 4),
        (0.36, 2.78),
        (0.42, 3.3),
        *arc((0.0, 3.7), 0.4, 10, 70, 4),
        (0.0, 4.1),
    ]
    return lying(stacked(lambda size: circle(28, size), mirrored(half)), 1.0)


def paddle() -> Mesh:
    """A flat plate for beating and smoothing, with a grip on its back."""

    def outline(size: float) -> Points:
        # The grip is round, the plate a rounded rectangle.
        if size <= 0.3:
            return circle(40, size)
        inset = 1.0 - size
        return rounded_square(40, (0.7 - inset, 1.0 - inset), 5.0)

    edge = [(0.94, 0.0), (0.982, 0.018), (1.0, 0.06), (1.0, 0.2), (0.98, 0.24), (0.94, 0.26)]
    return stacked(outline, [(0.0, 0.0), (0.6, 0.0), *edge, (0.6, 0.26), *grip(0.28, 0.26, 1.5)])


def stamp() -> Mesh:
    """A round plate with a star in relief, and a grip."""
    count = 40
    angle = 2 * np.pi * np.arange(count) / count
    # Each of the five points has eight steps, from tip to notch and back on straight lines.
    step = np.arange(count) % 8
    along = np.minimum(step, 8 - step) / 4
    tip, notch = np.array((0.78, 0.0)), 0.36 * np.array((np.cos(np.pi / 5), np.sin(np.pi / 5)))
    straight = tip + along[:, None] * (notch - tip)
    radius = np.linalg.norm(straight, axis=1)
    offset = np.arctan2(straight[:, 1], straight[:, 0])
    polar = np.where(step <= 4, offset, -offset) + 2 * np.pi / 5 * ((np.arange(count) + 3) // 8)
    polar += np.pi / 2
    star = radius[:, None] * np.column_stack([np.cos(polar), np.sin(polar)])

    def round_ring(size: float) -> Points:
        return size * np.column_stack([np.cos(angle + np.pi / 2), np.sin(angle + np.pi / 2)])

    rings = [ring(0.9 * star, 0.0), ring(star, 0.06), ring(1.08 * star, 0.34)]
    plate = [(0.97, 0.34), (1.0, 0.37), (1.0, 0.55), (0.95, 0.6), *grip(0.3, 0.6, 2.0)[:-1]]
    rings += [ring(round_ring(size), height) for size, height in plate]
    return loft(rings, np.zeros(3), np.array((0.0, 0.0, 2.0)))


def knife() -> Mesh:
    """A thin blade along the stroke with a sharp edge, and a handle.

    Made of outlines at stations along Y, each from the edge up the right and down the left side.
    """
    heights = (0.35, 2.0, 4.0, 5.6, 5.8, 6.4, 7.4, 8.0, 8.2)
    halves = (0.05, 0.05, 0.05, 0.05, 0.22, 0.26, 0.26, 0.22, 0.10)
    stations = np.array((-1.0, -0.92, -0.7, -0.35, 0.0, 0.35, 0.7, 0.92, 1.0))
    thinner = np.array((0.25, 0.75, 1.0, 1.0, 1.0, 1.0, 1.0, 0.75, 0.25))
    outlines = []
    for y, scale in zip(stations, thinner, strict=True):
        lifted = 0.18 * abs(y) ** 4
        handle = 0.55 * y
        right = [
            (scale * half, y if z < 5.7 else handle, lifted + z if z < 1 else z)
            for z, half in zip(heights, halves, strict=True)
        ]
        left = [(-x, side_y, z) for x, side_y, z in reversed(right)]
        outlines.append(np.array([(0.0, y, lifted), *right, *left]))
    return strips(outlines)


def strips(outlines: Sequence[Points]) -> Mesh:
    """Connect and close a row of outlines symmetric about x = 0, whose first point is at x = 0."""
    count = len(outlines[0])
    vertices = np.concatenate(outlines)
    current = np.arange(count)
    following = (current + 1) % count
    faces = []
    for station in range(len(outlines) - 1):
        low, high = station * count, (station + 1) * count
        faces.append(np.column_stack([low + current, high + following, low + following]))
        faces.append(np.column_stack([low + current, high + current, high + following]))
    cap = [(0, 1, count - 1)]
    for k in range(1, count // 2):
        cap += [(k, k + 1, count - k), (k + 1, count - k - 1, count - k)]
    ends = np.array([face for face in cap if len(set(face)) == 3])
    faces += [ends, ends[:, ::-1] + (len(outlines) - 1) * count]
    return vertices, np.concatenate(faces)


def wire() -> Mesh:
    """A taut wire across the stroke, with a bead at either end to hold it."""
    radius = 0.04
    half = [
        (radius, 0.9),
        (radius, 4.0),
        *arc((0.0, 4.28), 0.28, -75, 75, 9),
        (0.0, 4.56),
    ]
    return lying(stacked(lambda size: circle(12, size), mirrored(half)), radius)


def loop() -> Mesh:
    """A ribbon bent into a ring that faces the stroke, on a handle."""
    count, width, half = 40, 0.22, 0.04
    # Cross section (outward, along the stroke); both edges of the ribbon are sharp.
    section = ((0.0, width), (half, 0.5 * width), (half, -0.5 * width),
               (0.0, -width), (-half, -0.5 * width), (-half, 0.5 * width))  # fmt: skip
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count - np.pi / 2
    out = np.column_stack([np.cos(angle), np.zeros(count), np.sin(angle)])
    rows = [np.array((0.0, y, np.cos(np.pi / count))) + (1.0 - half + r) * out for r, y in section]
    vertices = np.stack(rows, 1).reshape(-1, 3)

    def index(turn: int, part: int) -> int:
        return (turn % count) * 6 + part % 6

    top = range(count // 2 - 3, count // 2 + 2)
    faces = []
    for turn in range(count):
        for part in range(6):
            if part == 1 and turn in top:
                continue
            a, b = index(turn, part), index(turn, part + 1)
            c, d = index(turn + 1, part + 1), index(turn + 1, part)
            faces += [(a, b, c), (a, c, d)]
    # The handle is attached to the gap at the top.
    gap = [index(turn, 2) for turn in range(top[0], top[-1] + 2)]
    gap += [index(turn, 1) for turn in range(top[-1] + 1, top[0] - 1, -1)]
    start = vertices[gap]
    angles = np.arctan2(start[:, 1] / width, start[:, 0] / np.abs(start[:, 0]).max())
    rings = [gap]
    extra: list[Points] = []
    for radius, height in ((0.18, 2.3), (0.2, 2.6), (0.26, 3.6), (0.24, 4.6), (0.14, 4.75)):
        rings.append([len(vertices) + len(extra) + k for k in range(len(gap))])
        extra += [np.array((radius * np.cos(a), radius * np.sin(a), height)) for a in angles]
    pole = len(vertices) + len(extra)
    extra.append(np.array((0.0, 0.0, 4.8)))
    for low, high in pairwise(rings):
        for k in range(len(gap)):
            n = (k + 1) % len(gap)
            faces += [(low[k], low[n], high[n]), (low[k], high[n], high[k])]
    faces += [(rings[-1][k], rings[-1][(k + 1) % len(gap)], pole) for k in range(len(gap))]
    return np.concatenate([vertices, np.array(extra)]), np.array(faces)


TOOLS: tuple[Callable[[], Mesh], ...] = (
    finger, palm, ball, rolling_pin, paddle, knife, wire, loop, stamp,
)  # fmt: skip


def write_obj(path: Path, mesh: Mesh) -> None:
    """Write a mesh as a Wavefront OBJ file, wound outward."""
    vertices, faces = mesh
    corners = vertices[faces]
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    if volume < 0:
        faces = faces[:, ::-1]
    lines = [f"# {path.stem}: drawn by tools/tool_meshes.py"]
    lines += ["v " + " ".join(f"{value + 0.0:.5g}" for value in row) for row in vertices.round(5)]
    lines += ["f " + " ".join(str(index + 1) for index in row) for row in faces.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for draw in TOOLS:
        write_obj(FOLDER / f"{draw.__name__}.obj", draw())
