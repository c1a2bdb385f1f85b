# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of particles as shaded balls on an incline, with shadows, drawn with NumPy alone."""

import math

import numpy as np
from numpy.typing import NDArray

SUN = np.array((-0.35, -0.55, 0.76)) / np.linalg.norm((-0.35, -0.55, 0.76))
"""Direction to the light."""
SKY = 0.42
"""Ambient light, relative to the sun."""
GRID = 0.02
"""Spacing of the lines on the incline [m]."""


class View:
    """A parallel projection.

    Args:
        toward: Direction from the scene to the eye, shape [3].
        center: Point at the center of the picture [m], shape [3].
        width: Width of the visible region [m].
        size: Width and height of the picture [pixels].
    """

    def __init__(
        self,
        toward: NDArray[np.float64],
        center: NDArray[np.float64],
        width: float,
        size: tuple[int, int],
    ) -> None:
        self.toward = toward / np.linalg.norm(toward)
        self.right = np.cross((0.0, 0.0, 1.0), self.toward)
        self.right /= np.linalg.norm(self.right)
        self.up = np.cross(self.toward, self.right)
        self.center = center
        self.size = size
        self.scale = size[0] / width

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return column and row [pixels], and height towards the eye [m], shape [..., 3]."""
        offset = points - self.center
        return np.stack(
            [
                0.5 * self.size[0] + offset @ self.right * self.scale,
                0.5 * self.size[1] - offset @ self.up * self.scale,
                offset @ self.toward,
            ],
            -1,
        )

    def rays(self) -> NDArray[np.float64]:
        """A point on each pixel's ray, in the plane through the center [m], shape [H, W, 3]."""
        columns = (np.arange(self.size[0]) + 0.5 - 0.5 * self.size[0]) / self.scale
        rows = (0.5 * self.size[1] - np.arange(self.size[1]) - 0.5) / self.scale
        return self.center + rows[:, None, None] * self.up + columns[None, :, None] * self.right


def draw_balls(
    view: View, points: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return height towards the eye [m], -inf where empty, and outward normal of each pixel."""
    columns, rows = view.size
    height = np.full((rows, columns), -np.inf)
    normal = np.zeros((rows, columns, 3))
    reach = radius * view.scale
    for column, row, middle in view.project(points):
        left, right = max(math.floor(column - reach), 0), min(math.ceil(column + reach), columns)
        top, bottom = max(math.floor(row - reach), 0), min(math.ceil(row + reach), rows)
        if left >= right or top >= bottom:
            continue
        across = (np.arange(left, right) + 0.5 - column)[None, :] / reach
        along = (row - np.arange(top, bottom) - 0.5)[:, None] / reach
        rest = 1.0 - across**2 - along**2
        out = np.sqrt(np.maximum(rest, 0.0))
        depth = middle + radius * out
        nearer = (rest > 0.0) & (depth > height[top:bottom, left:right])
        height[top:bottom, left:right][nearer] = depth[nearer]
        bent = across[..., None] * view.right + along[..., None] * view.up
        bent = bent + out[..., None] * view.toward
        normal[top:bottom, left:right][nearer] = bent[nearer]
    return height, normal


def draw_incline(
    view: View, angle: float, box: tuple[float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Draw a wedge that slopes down towards +x.

    Args:
        view: The projection.
        angle: Angle of the incline [rad].
        box: Start and end along x, and half width [m].

    Returns:
        Height towards the eye [m], -inf where empty, normals and linear colors, per pixel.
    """
    begin, end, breadth = box
    foot = -end * math.tan(angle)
    rays = view.rays()
    height = np.full(rays.shape[:2], -np.inf)
    normal = np.zeros_like(rays)
    color = np.zeros_like(rays)
    slope = np.array((math.sin(angle), 0.0, math.cos(angle)))
    front = np.array((0.0, -1.0, 0.0))
    for facing, offset in ((slope, 0.0), (front, breadth)):
        along = (offset - rays @ facing) / (view.toward @ facing)
        point = rays + along[..., None] * view.toward
        x, y, z = point[..., 0], point[..., 1], point[..., 2]
        inside = (x > begin) & (x < end) & (np.abs(y) < breadth + 1e-9)
        tone = np.full(rays.shape[:2], 0.62)
        if facing is front:
            inside &= (z > foot - 0.004) & (z < -x * math.tan(angle))
            tone *= 0.8
        else:
            pixel = 0.75 / view.scale
            for place in (x / math.cos(angle), y):
                tone[np.abs((place + 0.5 * GRID) % GRID - 0.5 * GRID) < pixel] *= 0.8
        nearer = inside & (along > height)
        height[nearer] = along[nearer]
        normal[nearer] = facing
        color[nearer] = (tone[..., None] * np.array((0.98, 0.96, 0.92)))[nearer]
    return height, normal, color


def shade(
    view: View,
    points: NDArray[np.float64],
    radius: float,
    color: tuple[float, float, float],
    angle: float,
    box: tuple[float, float, float],
) -> NDArray[np.float64]:
    """Render balls on an incline.

    Args:
        view: The projection.
        points: Centers of the balls [m], shape [N, 3].
        radius: Radius of the balls [m].
        color: Color of the balls, linear RGB.
        angle: Angle of the incline [rad].
        box: See `draw_incline`.

    Returns:
        Linear RGB, shape [H, W, 3], on white.
    """
    height, normal, albedo = draw_incline(view, angle, box)
    ball_height, ball_normal = draw_balls(view, points, radius)
    balls = ball_height > height
    height = np.where(balls, ball_height, height)
    normal[balls] = ball_normal[balls]
    albedo[balls] = color
    seen = np.isfinite(height)
    place = view.rays() + np.where(seen, height, 0.0)[..., None] * view.toward

    lamp = View(SUN, view.center, 1.6 * view.size[0] / view.scale, (900, 900))
    shadow_map, _ = draw_balls(lamp, points, radius)
    spot = lamp.project(place)
    lit = np.zeros(seen.shape)
    steps = np.linspace(-2.5, 2.5, 4)
    for across in steps:
        for along in steps:
            column = np.clip((spot[..., 0] + across).astype(int), 0, lamp.size[0] - 1)
            row = np.clip((spot[..., 1] + along).astype(int), 0, lamp.size[1] - 1)
            lit += shadow_map[row, column] < spot[..., 2] + 0.35 * radius
    lit /= len(steps) ** 2

    # Crevices, which lie deeper than their surroundings, get less ambient light.
    filled = np.where(seen, height, height[seen].min())
    hollow = _blurred(filled, max(2, round(1.2 * radius * view.scale))) - filled
    open_sky = np.clip(1.0 - 0.35 * hollow / radius, 0.35, 1.1)

    sun = np.clip(normal @ SUN, 0.0, 1.0) * lit
    light = sun + SKY * open_sky * (0.65 + 0.35 * normal[..., 2])
    halfway = SUN + view.toward
    halfway /= np.linalg.norm(halfway)
    gloss = 0.10 * np.clip(normal @ halfway, 0.0, 1.0) ** 30 * lit * balls
    picture = albedo * light[..., None] + gloss[..., None]
    return np.where(seen[..., None], picture, 1.0)


def _blurred(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Box blur with squares of 2 width + 1 pixels, twice."""
    for _ in range(2):
        for axis in (0, 1):
            room = [(width + 1, width) if side == axis else (0, 0) for side in (0, 1)]
            padded = np.pad(values, room, mode="edge")
            total = np.cumsum(padded, axis)
            size = values.shape[axis]
            upper = np.take(total, range(2 * width + 1, 2 * width + 1 + size), axis)
            values = (upper - np.take(total, range(size), axis)) / (2 * width + 1)
    return values


def to_srgb(linear: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Convert linear light to the bytes of an image."""
    value = np.clip(linear, 0.0, 1.0)
    coded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(255 * coded).astype(np.uint8)
