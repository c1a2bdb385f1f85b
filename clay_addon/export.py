# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of the clay as one closed, coloured mesh: STL, OBJ, PLY or GLB.

Axes are those of Blender's own exporters: STL and PLY keep Z up, OBJ and GLB turn it to Y up. A
file's unit is the metre, or the millimetre where asked for, as slicers read STL. Colours are linear
in Blender and in GLB, and sRGB in OBJ and PLY; STL has none.
"""

from __future__ import annotations

import errno
import json
import os
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper
from numpy.typing import NDArray

from .surface import Surface, SurfaceError, reconstruct

SUFFIXES = (".stl", ".obj", ".ply", ".glb")
UNITS = {"m": 1.0, "mm": 1000.0}


class ExportError(ValueError):
    """The clay cannot be exported; the message says why and what to do."""


def write_mesh(surface: Surface, path: str | os.PathLike[str], *, unit: str = "m") -> Path:
    """Write a surface to a file in the format of its suffix.

    The file is written whole or not at all: a file of that name is replaced only by a complete
    one.

    Args:
        surface: The surface [m].
        path: File with the suffix .stl, .obj, .ply or .glb.
        unit: Unit of the numbers in the file, "m" or "mm"; GLB is always in metres.

    Returns:
        The path.

    Raises:
        ExportError: if the suffix or unit is unknown, the folder cannot be written to, the disk is
            full, or the clay is so far from the origin that single precision cannot hold it.
    """
    path = check_target(path, unit=unit)
    suffix = path.suffix.lower()
    vertices = surface.vertices * UNITS[unit]
    if suffix in (".obj", ".glb"):
        vertices = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    single = vertices.astype(np.float32)
    corners = single[surface.faces]
    if not np.isfinite(single).all() or (corners == np.roll(corners, 1, axis=1)).all(2).any():
        raise ExportError(
            "The clay is too small for how far it lies from the world's origin: a file of single"
            " precision cannot hold its shape. Move it closer to the origin."
        )
    writers = {".stl": _stl, ".obj": _obj, ".ply": _ply, ".glb": _glb}
    _write_whole(path, writers[suffix](single, surface.faces, surface.colors))
    return path


def check_target(path: str | os.PathLike[str], *, unit: str = "m") -> Path:
    """Check that a mesh can be written to a path, before any work is done.

    Raises:
        ExportError: if the suffix or unit is unknown, or the folder is not there.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        what = f"the suffix {path.suffix!r}" if suffix else "a file without a suffix"
        raise ExportError(
            f"Cannot export to {what} ({path.name}). Use one of {', '.join(SUFFIXES)}."
        )
    if unit not in UNITS:
        raise ExportError(f"The unit must be one of {', '.join(UNITS)}, not {unit!r}.")
    if suffix == ".glb" and unit != "m":
        raise ExportError("A .glb file is always in metres; leave the unit at m.")
    if not path.parent.is_dir():
        raise ExportError(f"The folder {path.parent} does not exist. Make it first.")
    if path.is_dir():
        raise ExportError(f"{path} is a folder. Give the name of a file.")
    return path


def export_clay(
    context: bpy.types.Context,
    path: str | os.PathLike[str],
    *,
    objects: Sequence[bpy.types.Object] | None = None,
    unit: str = "m",
) -> dict[str, Any]:
    """Export clay as it is at the current frame.

    Objects with the same particle distance become one surface, so that clay which touches is one
    piece.

    Args:
        context: Where the clay is.
        path: File with the suffix .stl, .obj, .ply or .glb.
        objects: Clay objects; all of the scene where not given.
        unit: Unit of the numbers in the file, "m" or "mm".

    Returns:
        ``file``, ``particles``, ``vertices``, ``faces``, ``volume`` [m^3], ``volume_error`` (the
        volume relative to the particles' own, minus one) and ``watertight``.

    Raises:
        ExportError: if there is no clay, or the file cannot be written; see `write_mesh`.
        SurfaceError: if the particles have no surface; see `surface.reconstruct`.
    """
    target = check_target(path, unit=unit)
    if objects is None:
        from .simulation import clay_objects

        objects = clay_objects(context.scene)
    if not objects:
        raise ExportError("There is no clay to export. Make clay first.")
    surface, particle_count, volume = clay_surface(context, objects)
    write_mesh(surface, target, unit=unit)
    return {
        "file": str(target),
        "particles": particle_count,
        "vertices": len(surface.vertices),
        "faces": len(surface.faces),
        "volume": surface.volume,
        "volume_error": surface.volume / volume - 1,
        # Holds by construction; `reconstruct` raises otherwise.
        "watertight": True,
    }


def clay_surface(
    context: bpy.types.Context, objects: Sequence[bpy.types.Object]
) -> tuple[Surface, int, float]:
    """Reconstruct clay objects as they are at the current frame, in world space.

    Returns:
        The surface [m], the number of particles, and their volume [m^3].

    Raises:
        ExportError: if an object is no clay.
        SurfaceError: if the particles have no surface.
    """
    scale = context.scene.unit_settings.scale_length
    groups: dict[float, list[tuple[NDArray[np.float64], NDArray[np.float32]]]] = {}
    for item in objects:
        positions, colors, spacing = _particles(context.scene, item)
        # Single precision in the properties must not keep equal spacings apart.
        key = float(f"{spacing * scale:.5g}")
        groups.setdefault(key, []).append((positions * scale, colors))
    surfaces = []
    volume = 0.0
    particle_count = 0
    for spacing, parts in groups.items():
        positions = np.concatenate([part[0] for part in parts])
        colors = np.concatenate([part[1] for part in parts])
        try:
            surfaces.append(reconstruct(positions, spacing, colors=colors))
        except ImportError as error:
            raise ExportError(
                "The package pysplashsurf is missing, so no surface can be made. Install the"
                " extension from the zip for this platform."
            ) from error
        volume += len(positions) * spacing**3
        particle_count += len(positions)
    return _joined(surfaces), particle_count, volume


def _particles(
    scene: bpy.types.Scene, item: bpy.types.Object
) -> tuple[NDArray[np.float64], NDArray[np.float32], float]:
    """World positions, colours and world spacing of a clay object, in Blender units."""
    from .mesh_geometry import transform
    from .pack import is_packed, packed_positions
    from .simulation import clay_colors, read_points

    if item.type != "POINTCLOUD":
        raise ExportError(f"{item.name!r} is a {item.type.lower()}, not clay.")
    local: NDArray[np.float32] | None = (
        packed_positions(item, scene.frame_current_final)
        if is_packed(item)
        else read_points(item, "position")
    )
    if local is None or len(local) == 0:
        raise ExportError(f"{item.name!r} has no particles.")
    spacing = getattr(getattr(item, "tactile_clay", None), "spacing", 0.0)
    if not spacing > 0:
        radius = item.data.attributes.get("radius")
        spacing = 2 * radius.data[0].value if radius else 0.0
    if not spacing > 0:
        raise ExportError(f"{item.name!r} has no particle distance. Make the clay again.")
    matrix = np.array(item.matrix_world, np.float64)
    stretch = np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    if not stretch > 0:
        raise ExportError(f"{item.name!r} is scaled to nothing. Give it a scale above 0.")
    return transform(matrix, local), clay_colors(item), float(spacing * stretch)


def _joined(surfaces: list[Surface]) -> Surface:
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    colors = [surface.colors for surface in surfaces if surface.colors is not None]
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate(
            [surface.faces + start for surface, start in zip(surfaces, starts, strict=False)]
        ),
        np.concatenate(colors) if colors else None,
    )


Colors = NDArray[np.float32] | None


def _stl(vertices: NDArray[np.float32], faces: NDArray[np.int64], colors: Colors) -> bytes:
    """Return a binary STL file."""
    corners = vertices[faces]
    records = np.zeros(
        len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("tag", "<u2")])
    )
    records["normal"] = _unit(_area_vectors(vertices, faces))
    records["corners"] = corners
    header = b"Tactile Clay".ljust(80, b" ")
    return header + struct.pack("<I", len(faces)) + records.tobytes()


def _obj(vertices: NDArray[np.float32], faces: NDArray[np.int64], colors: Colors) -> bytes:
    """Return an OBJ file; colours follow the coordinates, as most programs read them."""
    lines = ["# Tactile Clay", "o Clay"]
    if colors is None:
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    else:
        both = np.concatenate([vertices, _srgb(colors[:, :3])], axis=1).tolist()
        lines += [f"v {x:.9g} {y:.9g} {z:.9g} {r:.4f} {g:.4f} {b:.4f}" for x, y, z, r, g, b in both]
    lines += ["s 1"]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")


def _ply(vertices: NDArray[np.float32], faces: NDArray[np.int64], colors: Colors) -> bytes:
    """Return a binary PLY file."""
    fields: list[Any] = [("position", "<f4", 3)]
    header = ["ply", "format binary_little_endian 1.0", "comment Tactile Clay"]
    header += [f"element vertex {len(vertices)}", *(f"property float {axis}" for axis in "xyz")]
    if colors is not None:
        fields.append(("color", "u1", 4))
        header += [f"property uchar {name}" for name in ("red", "green", "blue", "alpha")]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    points = np.zeros(len(vertices), np.dtype(fields))
    points["position"] = vertices
    if colors is not None:
        points["color"][:, :3] = np.rint(_srgb(colors[:, :3]) * 255)
        points["color"][:, 3] = np.rint(np.clip(colors[:, 3], 0, 1) * 255)
    polygons = np.zeros(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    polygons["count"] = 3
    polygons["corners"] = faces
    return ("\n".join(header) + "\n").encode("ascii") + points.tobytes() + polygons.tobytes()


def _glb(vertices: NDArray[np.float32], faces: NDArray[np.int64], colors: Colors) -> bytes:
    """Return a binary glTF 2.0 file with normals, without which viewers show facets."""
    normals = np.zeros((len(vertices), 3))
    area_vectors = _area_vectors(vertices, faces)
    for axis in range(3):
        normals[:, axis] = np.bincount(
            faces.ravel(), np.repeat(area_vectors[:, axis], 3), minlength=len(vertices)
        )
    arrays: list[tuple[str, NDArray[Any], str, int]] = [
        ("POSITION", vertices.astype("<f4"), "VEC3", 5126),
        ("NORMAL", _unit(normals).astype("<f4"), "VEC3", 5126),
    ]
    if colors is not None:
        arrays.append(("COLOR_0", np.clip(colors, 0, 1).astype("<f4"), "VEC4", 5126))
    arrays.append(("", faces.astype("<u4").ravel(), "SCALAR", 5125))
    blob = b"".join(array.tobytes() for _, array, _, _ in arrays)
    views, accessors, start = [], [], 0
    for name, array, kind, component in arrays:
        views.append(
            {
                "buffer": 0,
                "byteOffset": start,
                "byteLength": array.nbytes,
                "target": 34962 if name else 34963,
            }
        )
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": component,
                "count": len(array),
                "type": kind,
            }
        )
        start += array.nbytes
    accessors[0]["min"] = vertices.min(axis=0).tolist()
    accessors[0]["max"] = vertices.max(axis=0).tolist()
    primitive = {
        "attributes": {name: number for number, (name, *_) in enumerate(arrays) if name},
        "indices": len(arrays) - 1,
        "material": 0,
    }
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.6}
    scene = {
        "asset": {"version": "2.0", "generator": "Tactile Clay"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "Clay"}],
        "meshes": [{"name": "Clay", "primitives": [primitive]}],
        "materials": [{"name": "Clay", "pbrMetallicRoughness": surface}],
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(scene, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(blob)
    return (
        struct.pack("<4sII", b"glTF", 2, length)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(blob), b"BIN\0")
        + blob
    )


def _area_vectors(vertices: NDArray[np.float32], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    areas: NDArray[np.float64] = np.cross(b - a, c - a)
    return areas


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale to length 1; what has no direction points up, as glTF allows no zero normals."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])


def _srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    value = np.clip(linear, 0, 1)
    encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return encoded.astype(np.float32)


def _write_whole(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise ExportError(
                f"The disk is full: {path} could not be written"
                f" ({len(content) / 1e6:.1f} MB are needed)."
            ) from error
        raise ExportError(
            f"{path} could not be written ({error.strerror or error}). Choose another folder, or"
            " change its permissions."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


class CLAY_OT_export(bpy.types.Operator, ExportHelper):  # noqa: N801
    """Export the clay at the current frame as one closed, coloured mesh: STL, OBJ, PLY or GLB"""

    bl_idname = "clay.export"
    bl_label = "Export Clay"

    filename_ext = ".stl"
    check_extension = None
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"}
    )
    use_selection: bpy.props.BoolProperty(
        name="Selected Only", description="Export only selected clay", default=False
    )
    unit: bpy.props.EnumProperty(
        name="Unit",
        description="Unit of the numbers in the file",
        items=(
            ("m", "Metres", "As Blender's own exporters write"),
            ("mm", "Millimetres", "As programs for 3D printing read STL"),
        ),
        default="m",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where there is clay."""
        from .simulation import clay_objects

        return bool(clay_objects(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Export, or report why not."""
        from .simulation import clay_objects

        clay = clay_objects(context.scene)
        if self.use_selection:
            clay = [item for item in clay if item in context.selected_objects]
        window = None if bpy.app.background else context.window
        if window:
            window.cursor_modal_set("WAIT")
        try:
            result = export_clay(
                context, bpy.path.abspath(self.filepath), objects=clay, unit=self.unit
            )
        except (ExportError, SurfaceError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if window:
                window.cursor_modal_restore()
        self.report(
            {"INFO"}, f"{Path(result['file']).name}: {result['faces']:,} triangles, watertight"
        )
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_export)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_export)
