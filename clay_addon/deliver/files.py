# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a delivery: one USD or Alembic file per shape, and one USD file that plays them all.

Blender's exporters write each shape from a temporary scene, so that a delivery can be stopped
between two frames and never has more than one in memory. For USD, a small text file joins the
shapes with value clips (Pixar, *OpenUSD: Sequencable, Re-timeable Animated Value Clips*), which
hold each shape until the next one: vertices of different shapes are never interpolated, even for
motion blur, and held shapes are stored once.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..clay.look import set_input
from ..core.storage.atomic_files import replace_file
from ..core.surface.exact import Surface
from ..playback.shown_clay import ShownParticles
from .nodes import FILE_COLOR, delayed_group

VELOCITY_ATTRIBUTE = "velocity"
"""Attribute that Cycles uses for motion blur [Blender units/s]."""
ROOT_NAME = "clay.usda"
"""Name of the file that plays all shapes."""
FRAMES_FOLDER = "frames"
POINTS_PATH = "/Clay/points/PointCloud"


class FrameWriter:
    """Writes shapes with Blender's exporters, each to a separate file.

    Its data-blocks exist only during `write`, so that users can continue to work between frames,
    and undo steps do not include them.

    Args:
        folder: Folder for the files; it must exist.
        kind: ``usd`` or ``abc``.
        frames_per_second: ``fps`` and ``fps_base`` of the scene.
        points: Whether to also write the particles; not supported for Alembic.
    """

    def __init__(
        self, folder: Path, kind: str, *, frames_per_second: tuple[int, float], points: bool
    ) -> None:
        self._folder = folder
        self._kind = kind
        self._rate = frames_per_second
        self._points = points and kind == "usd"
        self.name = _unused_name("surface")
        """Name of the surface in the files."""

    @property
    def object_path(self) -> str:
        """Path of the surface within a file."""
        root = "/Clay" if self._kind == "usd" else ""
        return f"{root}/{self.name}/{self.name}"

    def path(self, number: int) -> Path:
        """File of the shape first shown at a frame."""
        return self._folder / f"clay_{number:06d}.{'usdc' if self._kind == 'usd' else 'abc'}"

    def write(self, number: int, surface: Surface, particles: Sequence[ShownParticles] = ()) -> int:
        """Write a shape.

        Args:
            number: First frame at which the shape is shown.
            surface: The surface [Blender units].
            particles: The particles of the surface, for `points`.

        Returns:
            The size of the file [bytes].

        Raises:
            OSError: The file could not be written.
        """
        path = self.path(number)
        blocks: list[bpy.types.ID] = []
        try:
            scene = self._scene(blocks)
            self._add_surface(scene, blocks, number, surface)
            if self._points:
                self._add_points(scene, blocks, number, particles)
            self._export(scene, number, path)
        finally:
            # Users are removed before the data-blocks they use.
            for block in blocks:
                bpy.data.batch_remove([block])
        size = path.stat().st_size if path.is_file() else 0
        if size == 0:
            raise OSError(f"Blender wrote nothing to {path}")
        return size

    def _scene(self, blocks: list[bpy.types.ID]) -> bpy.types.Scene:
        scene = bpy.data.scenes.new("Clay Delivery")
        blocks.append(scene)
        scene.render.fps, scene.render.fps_base = self._rate
        return scene

    def _add_surface(
        self, scene: bpy.types.Scene, blocks: list[bpy.types.ID], number: int, surface: Surface
    ) -> None:
        mesh = triangle_mesh(self.name, surface)
        item = _add_object(scene, blocks, self.name, mesh)
        assert surface.colors is not None
        if self._kind == "usd":
            assert surface.velocities is not None
            _add_attribute(mesh, FILE_COLOR, "FLOAT_COLOR", "color", surface.colors)
            _add_attribute(mesh, VELOCITY_ATTRIBUTE, "FLOAT_VECTOR", "vector", surface.velocities)
            _add_delay(item, blocks, number, "FACE")
            return
        # Blender's Alembic exporter supports neither other colors nor velocities.
        layer = mesh.attributes.new(FILE_COLOR, "BYTE_COLOR", "CORNER")
        corners = np.ascontiguousarray(surface.colors[surface.faces.ravel()], np.float32)
        layer.data.foreach_set("color", corners.ravel())
        mesh.attributes.active_color = layer

    def _add_points(
        self,
        scene: bpy.types.Scene,
        blocks: list[bpy.types.ID],
        number: int,
        particles: Sequence[ShownParticles],
    ) -> None:
        """Add a point cloud made from a mesh by nodes: Blender 4.5 cannot resize a point cloud."""
        positions = np.concatenate([part.positions for part in particles])
        mesh = bpy.data.meshes.new("particles")
        source = bpy.data.objects.new("particles", mesh)
        mesh.vertices.add(len(positions))
        for name, kind, key, values in (
            ("position", "FLOAT_VECTOR", "vector", positions),
            (FILE_COLOR, "FLOAT_COLOR", "color", [part.colors for part in particles]),
            (VELOCITY_ATTRIBUTE, "FLOAT_VECTOR", "vector", [p.velocities for p in particles]),
        ):
            whole = np.concatenate(values) if isinstance(values, list) else values
            _add_attribute(mesh, name, kind, key, whole)
        item = _add_object(scene, blocks, "points", bpy.data.pointclouds.new("points"))
        modifier = _add_delay(item, blocks, number, "POINT")
        set_input(modifier, "Particles", source)
        set_input(modifier, "Radius", 0.5 * particles[0].spacing)
        blocks += [source, mesh]

    def _export(self, scene: bpy.types.Scene, number: int, path: Path) -> None:
        # The exporter writes constant values as defaults, which value clips ignore. Therefore the
        # previous frame has only one triangle of the shape.
        scene.frame_start, scene.frame_end = number - 1, number
        scene.frame_set(number)
        with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            try:
                if self._kind == "usd":
                    _call_exporter(
                        bpy.ops.wm.usd_export,
                        filepath=str(path),
                        check_existing=False,
                        export_animation=True,
                        export_materials=False,
                        export_uvmaps=False,
                        export_normals=False,
                        convert_world_material=False,
                        export_custom_properties=False,
                        root_prim_path="/Clay",
                        evaluation_mode="RENDER",
                    )
                else:
                    _call_exporter(
                        bpy.ops.wm.alembic_export,
                        filepath=str(path),
                        check_existing=False,
                        start=number,
                        end=number,
                        uvs=False,
                        normals=False,
                        vcolors=True,
                        export_hair=False,
                        export_particles=False,
                        export_custom_properties=False,
                        evaluation_mode="RENDER",
                    )
            except RuntimeError as error:
                raise OSError(str(error).strip()) from error


def write_root(
    path: Path,
    shapes: Mapping[int, Path],
    *,
    last: int,
    frames_per_second: float,
    meters_per_unit: float,
) -> None:
    """Write the text file that plays the shapes.

    Args:
        path: The .usda file.
        shapes: File of the shape shown at each frame, in ascending order.
        last: Last frame.
        frames_per_second: Frame rate of the scene [1/s].
        meters_per_unit: Unit of the shapes [m].

    Raises:
        OSError: The file cannot be written.
    """
    files = list(dict.fromkeys(shapes.values()))
    names = [f"@./{file.relative_to(path.parent).as_posix()}@" for file in files]
    first = next(iter(shapes))
    # Clip time equals stage time: it must not precede the shape, and may continue after it.
    active = ", ".join(f"({number}, {files.index(file)})" for number, file in shapes.items())
    text = f"""\
        #usda 1.0
        (
            defaultPrim = "Clay"
            doc = "Clay, one file per shape"
            endTimeCode = {last}
            framesPerSecond = {frames_per_second!r}
            metersPerUnit = {meters_per_unit!r}
            startTimeCode = {first}
            timeCodesPerSecond = {frames_per_second!r}
            upAxis = "Z"
        )

        def Xform "Clay" (
            clips = {{
                dictionary default = {{
                    double2[] active = [{active}]
                    asset[] assetPaths = [{", ".join(names)}]
                    asset manifestAssetPath = {names[0]}
                    string primPath = "/Clay"
                    double2[] times = [({first}, {first}), ({last + 1}, {last + 1})]
                }}
            }}
            prepend references = {names[0]}</Clay>
        )
        {{
        }}
        """
    content = inspect.cleandoc(text).encode() + b"\n"
    replace_file(path, path.with_suffix(".tmp"), lambda file: file.write(content))


def triangle_mesh(name: str, surface: Surface) -> bpy.types.Mesh:
    """Make a mesh of a surface's triangles, without colors or velocities."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(surface.vertices))
    mesh.loops.add(surface.faces.size)
    mesh.polygons.add(len(surface.faces))
    vertices = np.ascontiguousarray(surface.vertices, np.float32)
    mesh.attributes["position"].data.foreach_set("vector", vertices.ravel())
    mesh.loops.foreach_set("vertex_index", surface.faces.astype(np.int32).ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, surface.faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def _add_object(
    scene: bpy.types.Scene, blocks: list[bpy.types.ID], name: str, data: bpy.types.ID
) -> bpy.types.Object:
    item = bpy.data.objects.new(name, data)
    blocks += [item, data]
    scene.collection.objects.link(item)
    return item


def _add_delay(
    item: bpy.types.Object, blocks: list[bpy.types.ID], number: int, domain: str
) -> bpy.types.Modifier:
    group = delayed_group(domain)
    blocks.append(group)
    modifier = item.modifiers.new("Delay", "NODES")
    modifier.node_group = group
    set_input(modifier, "Frame", number)
    return modifier


def _add_attribute(mesh: bpy.types.Mesh, name: str, kind: str, key: str, values: Any) -> None:
    layer = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "POINT")
    layer.data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())


def _call_exporter(operator: Any, **options: Any) -> None:
    """Call an exporter with the options that this version of Blender supports."""
    known = operator.get_rna_type().properties.keys()
    operator(**{name: value for name, value in options.items() if name in known})


def _unused_name(name: str) -> str:
    """A name that no object or mesh has, so that Blender does not change it."""
    unused, count = name, 1
    while unused in bpy.data.objects or unused in bpy.data.meshes:
        count += 1
        unused = f"{name}_{count}"
    return unused
