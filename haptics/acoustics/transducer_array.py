# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry and acoustics of a transducer array, and how finely it can be driven."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...solver.core.preset_files import check_keys, preset_names, preset_path, read_tables

_PRESET_FOLDER = Path(__file__).resolve().parents[2] / "presets" / "arrays"

AMPLITUDE_LAWS = ("pulse_width", "linear")
"""How the amplitude steps of a driver board map to amplitudes."""

Real = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class TransducerArray:
    """An ultrasound phased array of T circular pistons that all vibrate at one frequency.

    A drive is one complex number per transducer: its magnitude, 0 to 1, is the amplitude relative
    to full drive, its argument the phase lag (time convention e^{-iωt}). All pressures are peak
    values, not root mean square.

    Example:
        >>> array = TransducerArray.preset("sonicsurface")
        >>> array = array.placed(matrix_world)              # where the array is in the world
        >>> drive = solve_drive(array, foci.positions, foci.pressures)

    Raises:
        ValueError: A value is not finite, out of range or inconsistent with the others; the message
            names it.
    """

    positions: Real
    """Centers of the transducers [m], shape [T, 3], in the order of a drive."""
    normals: Real
    """Unit vector of emission of each, shape [T, 3]; a single vector applies to all."""
    p0: float
    """Peak pressure on the axis of a transducer times the distance, at full drive [Pa·m]."""
    radius: float
    """Radius of the vibrating piston [m]; 0 for a source that emits equally in all directions."""
    frequency: float = 40e3
    """Frequency of the sound [Hz]."""
    speed_of_sound: float = 346.0
    """Speed of sound in air [m/s]; 346 at 25 °C."""
    phase_offsets: Real = field(default_factory=lambda: np.zeros(1))
    """Phase that each transducer adds by itself [rad], shape [T]; a single value applies to all."""
    phase_steps: int | None = None
    """Number of phases per period that the driver supports; None for continuous phases."""
    amplitude_steps: int | None = None
    """Number N of amplitudes besides off that the driver supports; 1 for transducers that are only
    on or off, None for continuous amplitudes."""
    amplitude_law: str = "pulse_width"
    """Amplitude of step n of N: "pulse_width" gives sin(π n / 2N), for a pulse that lasts n / N of
    half a period; "linear" gives n / N, for a board that compensates for the sine itself."""
    working_volume: Real = field(
        default_factory=lambda: np.array(((-0.12, -0.12, 0.05), (0.12, 0.12, 0.45)))
    )
    """Lowest and highest corner of the box in which foci may lie, in the array's own coordinates
    [m], shape [2, 3]."""
    pose: Real = field(default_factory=lambda: np.eye(4))
    """World from array coordinates (origin at the center, Z out of the array), shape [4, 4]."""

    def __post_init__(self) -> None:
        count = len(self.positions)
        if count == 0:
            raise ValueError("TransducerArray.positions is empty; it needs at least one.")
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (count, 3),
            "normals": (count, 3),
            "phase_offsets": (count,),
            "working_volume": (2, 3),
            "pose": (4, 4),
        }
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), np.float64)
            if (name, value.shape) in (("normals", (3,)), ("phase_offsets", (1,))):
                value = np.broadcast_to(value, shape)
            if value.shape != shape:
                raise ValueError(
                    f"TransducerArray.{name} has shape {value.shape}; expected {shape}."
                )
            if not np.isfinite(value).all():
                raise ValueError(f"TransducerArray.{name} has values that are not finite.")
            value = value.copy()
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if not np.allclose(np.linalg.norm(self.normals, axis=1), 1.0, atol=1e-6):
            raise ValueError("TransducerArray.normals must have length 1.")
        if not (self.working_volume[0] < self.working_volume[1]).all():
            raise ValueError(
                "TransducerArray.working_volume must hold the lowest corner, then the highest."
            )
        for name in ("p0", "radius", "frequency", "speed_of_sound"):
            number = getattr(self, name)
            if not math.isfinite(number) or number < 0 or (number == 0 and name != "radius"):
                bound = "at least 0" if name == "radius" else "greater than 0"
                raise ValueError(
                    f"TransducerArray.{name} is {number!r}; it must be a number {bound}."
                )
        if self.amplitude_law not in AMPLITUDE_LAWS:
            raise ValueError(
                f"TransducerArray.amplitude_law is {self.amplitude_law!r}; it must be one of "
                f"{', '.join(AMPLITUDE_LAWS)}."
            )
        for name, fewest in (("phase_steps", 2), ("amplitude_steps", 1)):
            steps = getattr(self, name)
            if steps is not None and steps < fewest:
                raise ValueError(
                    f"TransducerArray.{name} is {steps}; it must be at least {fewest}, or None."
                )

    @property
    def count(self) -> int:
        """Number of transducers."""
        return len(self.positions)

    @property
    def wavelength(self) -> float:
        """Wavelength of the sound in air [m]."""
        return self.speed_of_sound / self.frequency

    @property
    def wavenumber(self) -> float:
        """2π over the wavelength [rad/m]."""
        return 2.0 * math.pi / self.wavelength

    @property
    def position(self) -> Real:
        """Center of the array in world coordinates [m], shape [3]."""
        return self.pose[:3, 3].copy()

    @property
    def normal(self) -> Real:
        """Direction out of the array in world coordinates, shape [3]."""
        return self.pose[:3, 2].copy()

    def placed(self, pose: ArrayLike) -> TransducerArray:
        """A copy of the array at another pose.

        Args:
            pose: World from array coordinates, a rotation and a translation [m], shape [4, 4].

        Raises:
            ValueError: The matrix scales, shears, mirrors or has values that are not finite.
        """
        matrix = np.asarray(pose, np.float64)
        turn = matrix[:3, :3] if matrix.shape == (4, 4) else np.zeros((3, 3))
        rigid = np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-4)
        if not rigid or np.linalg.det(turn) < 0.0 or not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise ValueError(
                "An array can only be moved and rotated: its pose must be a 4×4 matrix of a "
                "rotation and a translation. Apply the object's scale first."
            )
        step = matrix @ np.linalg.inv(self.pose)
        return replace(
            self,
            positions=self.positions @ step[:3, :3].T + step[:3, 3],
            normals=_unit(self.normals @ step[:3, :3].T),
            pose=matrix,
        )

    def reaches(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point lies in the working volume, shape [P].

        Args:
            points: World coordinates [m], shape [P, 3]; points that are not finite lie outside.
        """
        inverse = np.linalg.inv(self.pose)
        local = np.asarray(points, np.float64).reshape(-1, 3) @ inverse[:3, :3].T + inverse[:3, 3]
        low, high = self.working_volume
        return np.asarray(((local >= low) & (local <= high)).all(axis=1))

    @classmethod
    def grid(
        cls,
        columns: int,
        rows: int,
        pitch: float,
        *,
        missing: ArrayLike = (),
        **values: Any,
    ) -> TransducerArray:
        """Make a flat grid in the XY plane, centered on the origin, that emits along +Z.

        Transducers are listed row by row: X grows fastest, then Y.

        Args:
            columns: Number of transducers along X.
            rows: Number of transducers along Y.
            pitch: Distance between neighbors [m].
            missing: Column and row of each empty place, shape [M, 2].
            values: All other fields of the class.

        Raises:
            ValueError: A count or the pitch is not greater than 0, or an empty place is not in the
                grid.
        """
        if columns < 1 or rows < 1 or not (math.isfinite(pitch) and pitch > 0):
            raise ValueError(
                f"A grid of {columns} × {rows} transducers with a pitch of {pitch!r} m cannot be "
                "made: all three must be greater than 0."
            )
        gaps = np.asarray(missing, np.int64).reshape(-1, 2)
        if ((gaps < 0) | (gaps >= (columns, rows))).any():
            raise ValueError("A missing transducer is not in the grid.")
        present = np.ones((rows, columns), bool)
        present[gaps[:, 1], gaps[:, 0]] = False
        row, column = np.nonzero(present)
        positions = np.zeros((len(row), 3))
        positions[:, 0] = (column - 0.5 * (columns - 1)) * pitch
        positions[:, 1] = (row - 0.5 * (rows - 1)) * pitch
        return cls(positions=positions, normals=np.array((0.0, 0.0, 1.0)), **values)

    @classmethod
    def preset_names(cls) -> list[str]:
        """Names of the presets that ship with the project, sorted."""
        return preset_names(_PRESET_FOLDER)

    @classmethod
    @cache
    def preset(cls, name: str) -> TransducerArray:
        """An array that ships with the project (``presets/arrays/*.toml``).

        Each file is read only once, because live frames need the array every time.

        Raises:
            ValueError: There is no such preset, or its file is damaged.
        """
        return cls.from_toml(preset_path(_PRESET_FOLDER, name, "array"))

    @classmethod
    def from_toml(cls, path: Path) -> TransducerArray:
        """Read an array from a TOML file.

        The ``[array]`` table holds fields of this class. The positions come from it too, or from a
        ``[grid]`` table with columns, rows, pitch [m] and missing.

        Raises:
            ValueError: The file is not valid TOML, a key is unknown or a value is invalid.
            OSError: The file cannot be read.
        """
        tables = read_tables(path, "array")
        values, grid = tables["array"], tables.get("grid")
        given_by_grid = {"positions", "normals"} if grid is not None else set()
        known = {entry.name for entry in fields(cls)} - given_by_grid - {"pose"}
        _check_table(path, values, known)
        if grid is not None:
            if not isinstance(grid, dict):
                raise ValueError(f"{path.name}: grid is {grid!r}; it must be a table.")
            _check_table(path, grid, {"columns", "rows", "pitch", "missing"})
        try:
            return cls(**values) if grid is None else cls.grid(**grid, **values)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path.name}: {error}") from error


def _check_table(path: Path, table: Mapping[str, object], known: set[str]) -> None:
    check_keys(path, table, known)
    for key, value in table.items():
        if isinstance(value, bool) or (isinstance(value, str) and key != "amplitude_law"):
            raise ValueError(f"{path.name}: {key} is {value!r}; it must be a number.")


def _unit(vectors: Real) -> Real:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
