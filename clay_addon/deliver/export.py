# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of the clay as one closed, colored mesh: STL, 3MF, OBJ, PLY or GLB.

The axes are those of Blender's own exporters: Z up in STL, 3MF and PLY, Y up in OBJ and GLB. Files
are in meters, or in millimeters on request, as slicers read STL; 3MF is always in millimeters.
Colors are linear in Blender and GLB, and sRGB in 3MF, OBJ and PLY, with 8 bits per channel; STL has
none. 3MF is written by `mesh_3mf`, the others by the trimesh library, whose 3MF export needs two
more packages and has no colors.
"""

from __future__ import annotations

import errno
import importlib.util
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..base.clock import shown_moment
from ..base.units import meters_per_unit
from ..core.storage.atomic_files import replace_file
from ..core.surface.exact import Surface
from ..core.surface.mesh_3mf import write_3mf
from ..playback.shown_clay import ShownClayError, ShownParticles, particles_surface
from .print_checks import base_area, check_print, flat_base, untangle

SUFFIXES = (".stl", ".3mf", ".obj", ".ply", ".glb")
UNITS = {"m": 1.0, "mm": 1000.0}
AUTO = "auto"
"""The unit that other programs expect in a file: millimeters in STL and 3MF, else meters."""
PRINTED = (".stl", ".3mf")
"""Formats for 3D printing; exported surfaces are checked for printability."""
MIN_WALL = 1.0
"""Thinnest wall that common printers can make [mm]; resin printers can make half of it."""


class ExportError(TactileClayError, ValueError):
    """The clay cannot be exported; the message says why and what to do."""


def write_mesh(surface: Surface, path: str | os.PathLike[str], *, unit: str = "m") -> Path:
    """Write a surface atomically to a file in the format of its suffix.

    Args:
        surface: The surface [m].
        path: File with the suffix .stl, .3mf, .obj, .ply or .glb.
        unit: Unit of the numbers in the file: "m", "mm", or "auto" for millimeters in STL and 3MF
            and meters in other formats. GLB is always in meters, 3MF in millimeters.

    Returns:
        The path.

    Raises:
        ExportError: The suffix or unit is unknown, the folder cannot be written to, the disk is
            full, trimesh is missing, or the clay is too far from the origin for single precision.
    """
    path = check_target(path, unit=unit)
    suffix = path.suffix.lower()
    vertices, normals = surface.vertices * UNITS[_unit_of(suffix, unit)], surface.normals
    # glTF does not allow zero normals.
    normals[~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    if suffix in (".obj", ".glb"):
        vertices, normals = _y_up(vertices), _y_up(normals)
    single = vertices.astype(np.float32)
    corners = single[surface.faces]
    if not np.isfinite(single).all() or (corners == np.roll(corners, 1, axis=1)).all(2).any():
        raise ExportError(
            "The clay is too far from the world origin for its size: single-precision files cannot"
            " represent its shape. Move it closer to the origin."
        )
    if suffix == ".3mf":
        colors = None if surface.colors is None else _eight_bits(_srgb(surface.colors))
        _write_atomically(path, lambda file: write_3mf(file, single, surface.faces, colors))
    else:
        content = _encode(suffix, single, surface.faces, normals, surface.colors)
        _write_atomically(path, lambda file: file.write(content))
    return path


def check_target(path: str | os.PathLike[str], *, unit: str = "m") -> Path:
    """Check that a mesh can be written to a path, before any work is done.

    Raises:
        ExportError: The suffix or unit is unknown, the folder does not exist, or trimesh is
            missing.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        what = f"the suffix {path.suffix!r}" if suffix else "a file without a suffix"
        raise ExportError(
            f"Cannot export to {what} ({path.name}). Use one of {', '.join(SUFFIXES)}."
        )
    if unit not in (*UNITS, AUTO):
        raise ExportError(f"The unit must be one of {', '.join(UNITS)}, {AUTO}, not {unit!r}.")
    if suffix == ".glb" and unit == "mm":
        raise ExportError("A .glb file is always in meters; leave the unit at m.")
    if not path.parent.is_dir():
        raise ExportError(f"The folder {path.parent} does not exist. Create it first.")
    if path.is_dir():
        raise ExportError(f"{path} is a folder. Enter the name of a file.")
    if importlib.util.find_spec("trimesh") is None:
        raise ExportError(
            "The package trimesh is missing, so no file can be written. Install the extension from"
            " the zip for this platform."
        )
    return path


def export_clay(
    context: bpy.types.Context,
    path: str | os.PathLike[str],
    *,
    objects: Sequence[bpy.types.Object] | None = None,
    unit: str = "m",
    base: float = 0.0,
    wall: float = MIN_WALL,
) -> dict[str, Any]:
    """Export the clay at the current frame.

    Objects with the same particle spacing become one surface, so that clay in contact is one piece.

    Args:
        context: The context of the clay.
        path: File with the suffix .stl, .3mf, .obj, .ply or .glb.
        objects: Clay objects; by default all of the scene.
        unit: Unit of the numbers in the file; see `write_mesh`.
        base: Height to cut off at the bottom for a flat base [mm].
        wall: Thinnest printable wall [mm], for warnings.

    Returns:
        ``file``, ``particles``, ``vertices``, ``faces``, ``volume`` [m^3], ``volume_error``
        (relative difference to the volume of the particles, before a base is cut), ``watertight``,
        ``size`` [mm] along the three axes, and ``print``. The latter is None except for STL and
        3MF, where it has ``crossings`` (number of intersecting pairs of triangles),
        ``thinnest_wall`` [mm], ``thin_share`` (fraction of the surface with walls below `wall`),
        ``base_area`` [mm^2] and ``warnings``.

    Raises:
        ExportError: There is no clay, or the file cannot be written; see `write_mesh`.
        SurfaceError: The particles have no surface; see `core.surface.exact.reconstruct`.
    """
    target = check_target(path, unit=unit)
    if objects is None:
        from ..model.clay_scene import clay_objects

        objects = clay_objects(context.scene)
    if not objects:
        raise ExportError("There is no clay to export. Make clay first.")
    surface, particle_count, volume = clay_surface(context, objects)
    for_printing = target.suffix.lower() in PRINTED
    if for_printing:
        surface = untangle(surface)
    volume_error = surface.volume / volume - 1
    if base > 0:
        surface = flat_base(surface, base / 1000)
    write_mesh(surface, target, unit=unit)
    return {
        "file": str(target),
        "particles": particle_count,
        "vertices": len(surface.vertices),
        "faces": len(surface.faces),
        "volume": surface.volume,
        "volume_error": volume_error,
        # By construction; `reconstruct` raises an error otherwise.
        "watertight": True,
        "size": (1000 * np.ptp(surface.vertices, axis=0)).tolist(),
        "print": _print_table(surface, wall) if for_printing else None,
    }


def _print_table(surface: Surface, wall: float) -> dict[str, Any]:
    report = check_print(surface, wall=wall / 1000)
    warnings = []
    if report.crossings:
        warnings.append(
            f"{report.crossings} pairs of triangles intersect, where layers of clay are thinner "
            "than the particle spacing. Most slicers repair this; thicker clay avoids it."
        )
    # A few triangles at a sharp edge are not a thin wall.
    if report.thin_share > 1e-3:
        warnings.append(
            f"{report.thin_share:.1%} of the surface has walls thinner than {wall:g} mm, the "
            f"thinnest {1000 * report.thinnest_wall:.2g} mm. They may fail to print."
        )
    return {
        "crossings": report.crossings,
        "thinnest_wall": 1000 * report.thinnest_wall,
        "thin_share": report.thin_share,
        "base_area": 1e6 * base_area(surface),
        "warnings": warnings,
    }


def _unit_of(suffix: str, unit: str) -> str:
    if suffix == ".3mf" or (unit == AUTO and suffix == ".stl"):
        return "mm"
    return "m" if unit == AUTO else unit


def clay_surface(
    context: bpy.types.Context, objects: Sequence[bpy.types.Object]
) -> tuple[Surface, int, float]:
    """Reconstruct the surface of clay objects at the current frame, in world space.

    Returns:
        The surface [m], the number of particles, and their volume [m^3].

    Raises:
        ExportError: An object is not clay.
        SurfaceError: The particles have no surface.
    """
    scene = context.scene
    scale = meters_per_unit(scene)
    try:
        parts = [part.scaled(scale) for part in _shown_particles(scene, objects)]
        return particles_surface(parts)
    except ShownClayError as error:
        raise ExportError(str(error)) from error
    except ImportError as error:
        raise ExportError(
            "The package pysplashsurf is missing, so no surface can be made. Install the"
            " extension from the zip for this platform."
        ) from error


def _shown_particles(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]
) -> list[ShownParticles]:
    """The particles shown at the current frame, baked or not."""
    from ..playback.shown_clay import ShownClay

    return ShownClay(scene, objects, None).read(shown_moment(scene))


def _y_up(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)


def _encode(
    suffix: str,
    vertices: NDArray[np.float32],
    faces: NDArray[np.int64],
    normals: NDArray[np.float64],
    colors: NDArray[np.float32] | None,
) -> bytes:
    """Encode a mesh in the format of a suffix."""
    import trimesh

    # Without these, trimesh computes normals itself. Without scipy, as in Blender, this takes
    # quadratic time.
    mesh = trimesh.Trimesh(
        vertices, faces, vertex_normals=normals, process=False, metadata={"name": "Clay"}
    )
    if suffix == ".stl":
        return mesh.export(file_type="stl")
    if suffix == ".glb":
        # Without a material, glTF's default applies, which is metallic.
        material = trimesh.visual.material.PBRMaterial(
            name="Clay", metallicFactor=0.0, roughnessFactor=0.6
        )
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        if colors is not None:
            mesh.visual.vertex_attributes["color"] = _eight_bits(colors)
        return mesh.export(file_type="glb", include_normals=True)
    if colors is not None:
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=_eight_bits(_srgb(colors)))
    if suffix == ".ply":
        return mesh.export(file_type="ply", vertex_normal=False)
    # trimesh writes OBJ with a fixed number of decimals. Single precision needs nine digits.
    decimals = max(6, 8 - math.floor(math.log10(np.abs(vertices).max())))
    text: str = mesh.export(
        file_type="obj", include_normals=True, digits=decimals, header="Tactile Clay"
    )
    return text.encode("ascii")


def _srgb(colors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert linear RGBA to sRGB; alpha is unchanged."""
    linear = np.clip(colors[:, :3], 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.concatenate([encoded, colors[:, 3:]], axis=1).astype(np.float32)


def _eight_bits(colors: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8)


def _write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        replace_file(path, temporary, write)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise ExportError(
                f"The disk is full: {path} could not be written. Free some space and try again."
            ) from error
        raise ExportError(
            f"{path} could not be written ({error.strerror or error}). Choose another folder, or"
            " change its permissions."
        ) from error
