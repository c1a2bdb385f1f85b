# SPDX-License-Identifier: GPL-3.0-or-later
"""The image of a demo: several frames of its animation on one sheet.

Either all have the same size, two per row, or the last one is large with the others in a row below.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..clay.look import surface_object
from ..deliver.export import clay_surface
from ..model.clay_scene import clay_objects

GAP = 10
"""Width of the lines between frames on a sheet 1440 pixels wide [pixels]."""
GAP_COLOR = (0.96, 0.94, 0.90, 1.0)

Picture = NDArray[np.float32]
"""RGBA pixels, shape [height, width, 4], top row first."""


def render_moments(
    context: bpy.types.Context,
    moments: Sequence[int],
    widths: Sequence[int],
    samples: int,
    folder: Path,
    progress: Callable[[float, str], None],
) -> list[Picture]:
    """Render frames with the exact surfaces of all clay, in the scene's aspect ratio.

    Args:
        context: Its scene is rendered.
        moments: Frame numbers.
        widths: Width of each frame [pixels].
        samples: Samples per pixel in the widest frames; narrower ones use half as many.
        folder: Folder for temporary files.
        progress: Called with the completed fraction and a description of the current work.

    Raises:
        SurfaceError: The clay has no surface.
    """
    scene = context.scene
    render = scene.render
    scene.cycles.device = "CPU"
    aspect = render.resolution_y / render.resolution_x
    render.resolution_percentage = 100
    render.image_settings.file_format = "PNG"
    render.use_persistent_data = True
    # The saved .blend has better settings; these save a minute with little visible difference.
    scene.cycles.max_bounces = 3
    clays = clay_objects(scene)
    for clay in clays:
        clay.hide_render = True
    cost = np.cumsum([0, *(width**2 for width in widths)]) / sum(width**2 for width in widths)
    pictures = []
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        for index, (frame, width) in enumerate(zip(moments, widths, strict=True)):
            progress(float(cost[index]), f"image {index + 1} of {len(moments)}")
            scene.frame_set(frame)
            shown = surface_object(clay_surface(context, clays)[0], "Shown clay")
            scene.collection.objects.link(shown)
            render.resolution_x, render.resolution_y = width, max(1, round(aspect * width))
            scene.cycles.samples = samples if width == max(widths) else max(1, samples // 2)
            render.filepath = str(Path(temporary) / f"{index}.png")
            bpy.ops.render.render(write_still=True)
            pictures.append(_read_image(render.filepath))
            bpy.data.objects.remove(shown)
    return pictures


def pairs_sheet(panels: Sequence[Picture]) -> Picture:
    """Arrange frames of equal size two per row, with thin lines between and around them."""
    height, width, _ = panels[0].shape
    rows = (len(panels) + 1) // 2
    gap = gap_of(2 * width)
    sheet = np.empty((rows * (height + gap) + gap, 2 * (width + gap) + gap, 4), np.float32)
    sheet[:] = GAP_COLOR
    for index, panel in enumerate(panels):
        top = gap + (index // 2) * (height + gap)
        left = gap + (index % 2) * (width + gap)
        sheet[top : top + height, left : left + width] = panel
    return sheet


def feature_sheet(panels: Sequence[Picture]) -> Picture:
    """Arrange the large last frame on top and the others in a row below it.

    Args:
        panels: Rendered frames in order, with the widths of `feature_widths`.
    """
    *small, large = panels
    height, width, _ = large.shape
    gap = gap_of(width)
    row = max((panel.shape[0] for panel in small), default=-gap)
    sheet = np.empty((height + row + 3 * gap, width + 2 * gap, 4), np.float32)
    sheet[:] = GAP_COLOR
    sheet[gap : gap + height, gap : gap + width] = large
    left = gap
    for panel in small:
        top = 2 * gap + height
        sheet[top : top + panel.shape[0], left : left + panel.shape[1]] = panel
        left += panel.shape[1] + gap
    return sheet


def feature_widths(count: int, width: int) -> list[int]:
    """Widths of frames for `feature_sheet` [pixels].

    Args:
        count: Number of frames.
        width: Width of the last, large one [pixels]; the others fill a row below it.
    """
    small = count - 1
    if small < 1:
        return [width] * count
    ends = np.linspace(0, width - (small - 1) * gap_of(width), small + 1).round().astype(int)
    return [*(max(1, int(each)) for each in np.diff(ends)), width]


def gap_of(width: int) -> int:
    """Width of the lines on a sheet of a given width [pixels]."""
    return max(2, round(GAP * width / 1440))


def write_picture(pixels: Picture, path: Path) -> None:
    """Write an image atomically as PNG."""
    image = bpy.data.images.new("Sheet", pixels.shape[1], pixels.shape[0])
    image.pixels.foreach_set(np.ascontiguousarray(pixels[::-1]).ravel())
    temporary = path.with_name(f".{path.name}")
    image.filepath_raw, image.file_format = str(temporary), "PNG"
    image.save()
    bpy.data.images.remove(image)
    temporary.replace(path)


def _read_image(path: str) -> Picture:
    image = bpy.data.images.load(path)
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]
