# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of a demonstration: moments of its film on one sheet.

Either all are of one size, two a row, or the last is large and the others stand in a row below it.
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
"""Width of the lines between pictures on a sheet of 1440 pixels [pixels]."""
GAP_COLOR = (0.96, 0.94, 0.90, 1.0)

Picture = NDArray[np.float32]
"""RGBA, shape [height, width, 4], from the top."""


def render_moments(
    context: bpy.types.Context,
    moments: Sequence[int],
    widths: Sequence[int],
    samples: int,
    folder: Path,
    progress: Callable[[float, str], None],
) -> list[Picture]:
    """Render frames with the exact surfaces of all clay, in the proportions of the scene's picture.

    Args:
        context: Its scene is rendered.
        moments: Frames.
        widths: Of each picture [pixels].
        samples: A pixel, in the widest pictures; narrower ones take half as many.
        folder: Where files may lie for a while.
        progress: Told which part is done, and what is being done.

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
    # The .blend keeps the finer settings; these cost a minute less and show little of it.
    scene.cycles.max_bounces = 3
    clays = clay_objects(scene)
    for clay in clays:
        clay.hide_render = True
    cost = np.cumsum([0, *(width**2 for width in widths)]) / sum(width**2 for width in widths)
    pictures = []
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        for index, (frame, width) in enumerate(zip(moments, widths, strict=True)):
            progress(float(cost[index]), f"picture {index + 1} of {len(moments)}")
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
    """Put pictures of one size two a row, with thin lines between and around them."""
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
    """Put the last picture, the large one, on top and the others in a row below it.

    Args:
        panels: In the order of their frames; widths as `feature_widths` gives them.
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
    """Widths of so many pictures, of which the last is the large one [pixels].

    The others fill a row below it, but for the lines between them.
    """
    small = count - 1
    if small < 1:
        return [width] * count
    ends = np.linspace(0, width - (small - 1) * gap_of(width), small + 1).round().astype(int)
    return [*(max(1, int(each)) for each in np.diff(ends)), width]


def gap_of(width: int) -> int:
    """Width of the lines on a sheet of a width [pixels]."""
    return max(2, round(GAP * width / 1440))


def write_picture(pixels: Picture, path: Path) -> None:
    """Write a picture as PNG, whole or not at all."""
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
