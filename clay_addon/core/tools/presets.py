# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools one sculpts with: small closed meshes and how they meet the clay.

A preset is two files in ``presets/tools``: ``NAME.toml`` says what the tool is and ``NAME.obj`` is
its shape, in the tool's own frame. One brush radius is 1, what meets the clay first is at the
origin, +Z points away from the clay, and +Y goes along the stroke.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....solver.core.errors import TactileClayError
from ....solver.geometry.closed_mesh import MeshError, check_closed_mesh

PRESET_FOLDER = Path(__file__).resolve().parents[3] / "presets" / "tools"

MODES = ("press", "cut", "scrape")
ALIGNMENTS = ("none", "stroke")

_MITRE = 2.0
"""How far a corner may go for each unit that its faces go."""
_TEXTS = ("label", "description", "mode", "align")
_NUMBERS = ("friction", "size", "thinnest", "thickness")


class ToolPresetError(TactileClayError, ValueError):
    """A tool preset cannot be used; the message names the file and what is wrong with it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ToolPreset:
    """A tool: its shape in its own frame, and how it meets the clay.

    Raises:
        ToolPresetError: A value is out of its range; the message names it.
    """

    name: str
    """Name in files."""
    label: str
    """Name in the interface."""
    description: str
    """What it does to clay, in one line."""
    mode: str
    """``press``: pushed into the surface; ``cut``: driven through the clay; ``scrape``: dragged
    half sunk, to take clay off."""
    friction: float
    """Coulomb friction coefficient."""
    size: float
    """Scale of the mesh, in brush radii."""
    align: str
    """``stroke``: +Y is turned along the stroke; ``none``: the tool is rotationally symmetric."""
    thinnest: float
    """Thickness of a cutting tool's thin part in its mesh; 0 for tools that are thick enough."""
    thickness: float
    """Least thickness of that part for a clean cut, in particle spacings."""
    vertices: NDArray[np.float64]
    """Vertices, a brush radius being 1, shape [V, 3]."""
    faces: NDArray[np.int32]
    """Triangles, counter-clockwise seen from outside, shape [F, 3]."""

    def __post_init__(self) -> None:
        for field, known in (("mode", MODES), ("align", ALIGNMENTS)):
            if getattr(self, field) not in known:
                raise ToolPresetError(
                    f"{field} is {getattr(self, field)!r}; it must be one of {', '.join(known)}."
                )
        for field in _NUMBERS:
            value = getattr(self, field)
            if not math.isfinite(value) or value < 0 or (field == "size" and value == 0):
                bound = "above 0" if field == "size" else "at least 0"
                raise ToolPresetError(f"{field} is {value!r}; it must be a number {bound}.")
        if (self.thinnest > 0) != (self.thickness > 0):
            raise ToolPresetError("thinnest and thickness go together: give both or neither.")

    def fitted(self, radius: float, spacing: float) -> NDArray[np.float64]:
        """Vertices for a brush radius, thick enough to cut clay of a particle spacing.

        If the tool would be too thin, all of its surface is moved outward by the same distance, so
        that edges stay sharp; the part that meets the clay first stays at height 0.

        Args:
            radius: Brush radius, in any unit of length.
            spacing: Distance between particles at rest, in the same unit.

        Returns:
            Vertices in the tool's own frame, in that unit, shape [V, 3].

        Raises:
            ValueError: A length is not above 0.
        """
        for name, value in (("radius", radius), ("spacing", spacing)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"The {name} is {value!r}; it must be above 0.")
        vertices = self.vertices * (self.size * radius)
        missing = self.thickness * spacing - self.thinnest * self.size * radius
        if missing <= 0:
            return vertices
        moved = vertices + 0.5 * missing * outward_ways(self.vertices, self.faces)
        # The beads at the ends of a wire lie lower than the part that meets the clay first.
        middle = np.hypot(*self.vertices[:, :2].T) <= 1.0
        moved[:, 2] -= moved[middle, 2].min()
        return moved


def outward_ways(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """How each vertex must move so that the faces around it move outward by 1, shape [V, 3].

    Least squares of the faces' normals, weighed by their angle at the vertex; corners move no
    farther than `_MITRE`.
    """
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moments, sums = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    for corner in range(3):
        first = corners[:, (corner + 1) % 3] - corners[:, corner]
        second = corners[:, (corner + 2) % 3] - corners[:, corner]
        lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", first, second) / lengths, -1.0, 1.0))
        np.add.at(moments, faces[:, corner], angle[:, None, None] * normals[:, :, None]
                  * normals[:, None])  # fmt: skip
        np.add.at(sums, faces[:, corner], angle[:, None] * normals)
    ways = np.einsum("vij,vj->vi", np.linalg.pinv(moments, rcond=0.02, hermitian=True), sums)
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    return ways * np.minimum(1.0, _MITRE / np.maximum(lengths, 1e-9))


def tool_preset_names(folder: Path = PRESET_FOLDER) -> list[str]:
    """Names that `load_tool_preset` knows, sorted.

    Args:
        folder: Where the presets are.
    """
    return sorted(path.stem for path in folder.glob("*.toml"))


def load_tool_preset(name: str, folder: Path = PRESET_FOLDER) -> ToolPreset:
    """Read a tool.

    Args:
        name: One of `tool_preset_names`.
        folder: Where the presets are.

    Raises:
        ToolPresetError: There is no such preset, or one of its files is missing or damaged; the
            message names the file and says what is wrong.
    """
    if name not in tool_preset_names(folder):
        known = ", ".join(tool_preset_names(folder)) or "none"
        raise ToolPresetError(f"There is no tool preset {name!r}. There are: {known}.")
    path = folder / f"{name}.toml"
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        values = _checked(table)
        vertices, faces = read_obj(path.with_suffix(".obj"))
        return ToolPreset(name=name, vertices=vertices, faces=faces, **values)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ToolPresetError(f"{path.name} is not a valid TOML file: {error}.") from error
    except OSError as error:
        raise ToolPresetError(f"{error.filename} cannot be read: {error.strerror}.") from error
    except ToolPresetError as error:
        raise ToolPresetError(f"{path.name}: {error}") from error


def _checked(table: dict[str, Any]) -> dict[str, Any]:
    """The values of a preset, each of its kind."""
    for key in table:
        if key not in (*_TEXTS, *_NUMBERS):
            known = ", ".join((*_TEXTS, *_NUMBERS))
            raise ToolPresetError(f"unknown key {key!r}. Known keys: {known}.")
    values: dict[str, Any] = {"thinnest": 0.0, "thickness": 0.0, **table}
    for key in _TEXTS:
        if not isinstance(values.get(key), str) or not values[key]:
            raise ToolPresetError(f"{key} is {values.get(key)!r}; it must be a text.")
    for key in _NUMBERS:
        value = values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ToolPresetError(f"{key} is {value!r}; it must be a number.")
        values[key] = float(value)
    return values


def read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Read vertices and triangles of a closed mesh from a Wavefront OBJ file.

    Of each face only the vertices are read; faces with more corners are split into a fan.

    Raises:
        ToolPresetError: A line cannot be parsed, or the mesh is not closed.
        OSError: The file cannot be read.
    """
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        kind, *words = line.split() or [""]
        try:
            if kind == "v":
                vertices.append([float(word) for word in words[:3]])
                if len(words) < 3:
                    raise ValueError("a vertex needs three numbers")
            elif kind == "f":
                corners = [int(word.partition("/")[0]) for word in words]
                if len(corners) < 3 or 0 in corners:
                    raise ValueError("a face needs three vertices, the first being 1")
                # Negative numbers count back from the latest vertex.
                corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                faces += [(corners[0], *pair) for pair in pairwise(corners[1:])]
        except ValueError as error:
            raise ToolPresetError(f"{path.name}, line {number}: {error}.") from error
    points = np.array(vertices, np.float64).reshape(-1, 3)
    try:
        return check_closed_mesh(points, np.array(faces, np.int32).reshape(-1, 3), name=path.name)
    except MeshError as error:
        raise ToolPresetError(str(error)) from error
