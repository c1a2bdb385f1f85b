# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a delivered clay: one USD or Alembic file a shape, and one that plays them all.

Blender's exporters write each shape from a scene of its own, so that a delivery can be stopped
between two frames and never holds more than one in memory. For USD a small text file joins them by
value clips (Pixar, *OpenUSD: Sequencable, Re-timeable Animated Value Clips*), which hold a shape
until the next one: vertices of different shapes are never mixed, whatever time a motion blur asks
for, and shapes that are held are stored once.
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
"""What Cycles makes motion blur from, per second."""
ROOT_NAME = "clay.usda"
"""The file that plays all shapes."""
FRAMES_FOLDER = "frames"
CLIP_FRAME = 1
"""The frame of the shape inside each file."""
POINTS_PATH = "/Clay/points/PointCloud"


class FrameWriter:
    """Writes shapes through Blender's exporters, each into a file of its own.

    What it needs in the .blend is there only while it writes: a person may do other things in
    between, and Undo keeps what there is.

    Args:
        folder: Where the files go; it must exist.
        kind: ``usd`` or ``abc``.
        first: The first frame delivered.
        frames_per_second: Of the scene [1/s].
        points: Whether the particles are written too; Alembic has none.
    """

    def __init__(
        self,
        folder: Path,
        kind: str,
        *,
        first: int,
        frames_per_second: tuple[int, float],
        points: bool,
    ) -> None:
        self._folder = folder
        self._kind = kind
        # Sequences of files have no negative numbers in Blender, nor elsewhere.
        self._number_of_zero = max(0, -first)
        self._rate = frames_per_second
        self._points = points and kind == "usd"
        self.name = _free_name("surface")
        """Name of the surface in the files."""

    @property
    def object_path(self) -> str:
        """Where in a file the surface is."""
        root = "/Clay" if self._kind == "usd" else ""
        return f"{root}/{self.name}/{self.name}"

    def path(self, number: int) -> Path:
        """The file of the shape first shown at a frame.

        Files are numbered by their frames, from 0 on where the delivery begins before frame 0.
        """
        place = number + self._number_of_zero
        return self._folder / f"clay_{place:06d}.{'usdc' if self._kind == 'usd' else 'abc'}"

    def write(self, number: int, surface: Surface, particles: Sequence[ShownParticles] = ()) -> int:
        """Write a shape.

        Args:
            number: The first frame at which it is shown.
            surface: The surface [Blender units].
            particles: What it was made from; written where points are wanted.

        Returns:
            The size of the file in bytes.

        Raises:
            OSError: It could not be written.
        """
        path = self.path(number)
        made: list[bpy.types.ID] = []
        try:
            scene = self._scene(made)
            self._add_surface(scene, made, surface)
            if self._points:
                self._add_points(scene, made, particles)
            self._export(scene, path)
        finally:
            # What uses another goes first.
            for block in made:
                bpy.data.batch_remove([block])
        size = path.stat().st_size if path.is_file() else 0
        if size == 0:
            raise OSError(f"Blender wrote nothing into {path}")
        return size

    def _scene(self, made: list[bpy.types.ID]) -> bpy.types.Scene:
        scene = bpy.data.scenes.new("Clay Delivery")
        made.append(scene)
        scene.render.fps, scene.render.fps_base = self._rate
        return scene

    def _add_surface(
        self, scene: bpy.types.Scene, made: list[bpy.types.ID], surface: Surface
    ) -> None:
        mesh = triangle_mesh(self.name, surface)
        item = _add_object(scene, made, self.name, mesh)
        assert surface.colors is not None
        if self._kind == "usd":
            assert surface.velocities is not None
            _add_attribute(mesh, FILE_COLOR, "FLOAT_COLOR", "color", surface.colors)
            _add_attribute(mesh, VELOCITY_ATTRIBUTE, "FLOAT_VECTOR", "vector", surface.velocities)
            _add_delayed(item, made, "FACE")
            return
        # Alembic of Blender has no other colors, and no velocities.
        layer = mesh.attributes.new(FILE_COLOR, "BYTE_COLOR", "CORNER")
        corners = np.ascontiguousarray(surface.colors[surface.faces.ravel()], np.float32)
        layer.data.foreach_set("color", corners.ravel())
        mesh.attributes.active_color = layer

    def _add_points(
        self,
        scene: bpy.types.Scene,
        made: list[bpy.types.ID],
        particles: Sequence[ShownParticles],
    ) -> None:
        """Add a point cloud whose nodes take it from a mesh: 4.5 can size no point cloud."""
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
        item = _add_object(scene, made, "points", bpy.data.pointclouds.new("points"))
        modifier = _add_delayed(item, made, "POINT")
        set_input(modifier, "Particles", source)
        set_input(modifier, "Radius", 0.5 * particles[0].spacing)
        made += [source, mesh]

    def _export(self, scene: bpy.types.Scene, path: Path) -> None:
        # The exporter writes what never changes as a default, which value clips do not read: so
        # the frame before shows one triangle of the shape, and the frame itself all of it.
        # Every file has the same frame, since the exporters know none before 0.
        scene.frame_start, scene.frame_end = CLIP_FRAME - 1, CLIP_FRAME
        scene.frame_set(CLIP_FRAME)
        with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            try:
                if self._kind == "usd":
                    _call(
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
                    _call(
                        bpy.ops.wm.alembic_export,
                        filepath=str(path),
                        check_existing=False,
                        start=CLIP_FRAME,
                        end=CLIP_FRAME,
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
    shown: Mapping[int, Path],
    *,
    last: int,
    frames_per_second: float,
    meters_per_unit: float,
) -> None:
    """Write the text file that plays the shapes.

    Args:
        path: The .usda file.
        shown: The file of the shape shown from each frame on, in ascending order.
        last: The last frame.
        frames_per_second: Of the scene [1/s].
        meters_per_unit: Meters in a unit of the shapes.

    Raises:
        OSError: It cannot be written.
    """
    files = list(dict.fromkeys(shown.values()))
    names = [f"@./{file.relative_to(path.parent).as_posix()}@" for file in files]
    first = next(iter(shown))
    active = ", ".join(f"({number}, {files.index(file)})" for number, file in shown.items())
    text = f"""\
        #usda 1.0
        (
            defaultPrim = "Clay"
            doc = "Clay, one file a shape"
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
                    double2[] times = [({first}, {CLIP_FRAME}), ({last + 1}, {CLIP_FRAME})]
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
    """A mesh of a surface's triangles, without attributes of its own."""
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
    scene: bpy.types.Scene, made: list[bpy.types.ID], name: str, data: bpy.types.ID
) -> bpy.types.Object:
    item = bpy.data.objects.new(name, data)
    made += [item, data]
    scene.collection.objects.link(item)
    return item


def _add_delayed(
    item: bpy.types.Object, made: list[bpy.types.ID], domain: str
) -> bpy.types.Modifier:
    group = delayed_group(domain)
    made.append(group)
    modifier = item.modifiers.new("Late", "NODES")
    modifier.node_group = group
    set_input(modifier, "Frame", CLIP_FRAME)
    return modifier


def _add_attribute(mesh: bpy.types.Mesh, name: str, kind: str, key: str, values: Any) -> None:
    layer = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "POINT")
    layer.data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())


def _call(operator: Any, **options: Any) -> None:
    """Call an exporter with those of the options that this Blender knows."""
    known = operator.get_rna_type().properties.keys()
    operator(**{name: value for name, value in options.items() if name in known})


def _free_name(name: str) -> str:
    """A name that no object and no mesh has, so that Blender leaves it as it is."""
    wanted, count = name, 1
    while wanted in bpy.data.objects or wanted in bpy.data.meshes:
        count += 1
        wanted = f"{name}_{count}"
    return wanted
