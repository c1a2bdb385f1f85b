# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an array's transducers are, how they sound, and how finely they can be driven."""

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
"""How a driver board's steps are amplitudes."""

Real = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class TransducerArray:
    """An ultrasound phased array of T circular pistons that all vibrate at one frequency.

    A drive is one complex number a transducer: its magnitude, 0 to 1, is the amplitude over the
    largest, its argument the phase by which the transducer lags, e^{-iωt} being understood. All
    pressures are peak values, not root mean square.

    Example:
        >>> array = TransducerArray.preset("sonicsurface")
        >>> array = array.placed(matrix_world)              # where the array stands
        >>> drive = solve_drive(array, foci.positions, foci.pressures)

    Raises:
        ValueError: A value is not finite, lies outside its range or does not fit the others; the
            message names it.
    """

    positions: Real
    """Centers of the transducers [m], shape [T, 3], in the order in which a drive lists them."""
    normals: Real
    """Unit vectors along which each of them emits, shape [T, 3]; one vector stands for all."""
    p0: float
    """Peak pressure on a transducer's axis times the distance, at full drive [Pa·m]."""
    radius: float
    """Radius of the vibrating piston [m]; 0 for a source that emits alike in all directions."""
    frequency: float = 40e3
    """Frequency of the sound [Hz]."""
    speed_of_sound: float = 346.0
    """Speed of sound in air [m/s]; 346 at 25 °C."""
    phase_offsets: Real = field(default_factory=lambda: np.zeros(1))
    """Phase that each transducer adds of itself [rad], shape [T]; one value stands for all."""
    phase_steps: int | None = None
    """Phases that the driver can tell apart in a period; any where not given."""
    amplitude_steps: int | None = None
    """Amplitudes N besides off that it can tell apart: with 1, a transducer is off or on; any
    amplitude where not given."""
    amplitude_law: str = "pulse_width"
    """What amplitude a step n of N is: sin(π n / 2N), as of a pulse of that part of half a period
    ("pulse_width"), or n / N, where the board makes up for that itself ("linear")."""
    working_volume: Real = field(
        default_factory=lambda: np.array(((-0.12, -0.12, 0.05), (0.12, 0.12, 0.45)))
    )
    """Corners of the box, in the array's own coordinates, where foci may lie [m], shape [2, 3]."""
    pose: Real = field(default_factory=lambda: np.eye(4))
    """World from the array's own coordinates (origin in the middle, Z out of it), shape [4, 4]."""

    def __post_init__(self) -> None:
        count = len(self.positions)
        if count == 0:
            raise ValueError("TransducerArray.positions is empty; an array has a transducer.")
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
        """Middle of the array in world coordinates [m], shape [3]."""
        return self.pose[:3, 3].copy()

    @property
    def normal(self) -> Real:
        """Direction out of the array in world coordinates, shape [3]."""
        return self.pose[:3, 2].copy()

    def placed(self, pose: ArrayLike) -> TransducerArray:
        """Stand the array somewhere else.

        Args:
            pose: World from the array's own coordinates, a rotation and a shift [m], shape [4, 4].

        Raises:
            ValueError: The matrix scales, shears, mirrors or holds values that are not finite.
        """
        matrix = np.asarray(pose, np.float64)
        turn = matrix[:3, :3] if matrix.shape == (4, 4) else np.zeros((3, 3))
        rigid = np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-4)
        if not rigid or np.linalg.det(turn) < 0.0 or not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise ValueError(
                "An array can be moved and turned only: its pose must be a 4×4 matrix of a "
                "rotation and a shift. Apply the object's scale first."
            )
        step = matrix @ np.linalg.inv(self.pose)
        return replace(
            self,
            positions=self.positions @ step[:3, :3].T + step[:3, 3],
            normals=_unit(self.normals @ step[:3, :3].T),
            pose=matrix,
        )

    def reaches(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Tell which points lie in the working volume, shape [P].

        Args:
            points: World coordinates [m], shape [P, 3]; what is not finite lies outside.
        """
        inverse = np.linalg.inv(self.pose)
        own = np.asarray(points, np.float64).reshape(-1, 3) @ inverse[:3, :3].T + inverse[:3, 3]
        low, high = self.working_volume
        return np.asarray(((own >= low) & (own <= high)).all(axis=1))

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
        """Lay out a flat grid in the XY plane, centered on the origin, that emits along +Z.

        Transducers are listed row by row: X grows fastest, then Y.

        Args:
            columns: How many stand along X.
            rows: How many stand along Y.
            pitch: Distance of neighbors [m].
            missing: Column and row of places without a transducer, shape [M, 2].
            values: Every other field of the class.

        Raises:
            ValueError: A count or the pitch is not greater than 0, or a place is not in the grid.
        """
        if columns < 1 or rows < 1 or not (math.isfinite(pitch) and pitch > 0):
            raise ValueError(
                f"A grid of {columns} × {rows} transducers {pitch!r} m apart cannot be laid out."
            )
        gaps = np.asarray(missing, np.int64).reshape(-1, 2)
        if ((gaps < 0) | (gaps >= (columns, rows))).any():
            raise ValueError("A place without transducer is given that is not in the grid.")
        there = np.ones((rows, columns), bool)
        there[gaps[:, 1], gaps[:, 0]] = False
        row, column = np.nonzero(there)
        positions = np.zeros((len(row), 3))
        positions[:, 0] = (column - 0.5 * (columns - 1)) * pitch
        positions[:, 1] = (row - 0.5 * (rows - 1)) * pitch
        return cls(positions=positions, normals=np.array((0.0, 0.0, 1.0)), **values)

    @classmethod
    def preset_names(cls) -> list[str]:
        """Names that `preset` knows, sorted."""
        return preset_names(_PRESET_FOLDER)

    @classmethod
    @cache
    def preset(cls, name: str) -> TransducerArray:
        """An array that ships with the project (``presets/arrays/*.toml``).

        Its file is read once: arrays are asked for in each frame, and never change.

        Raises:
            ValueError: No such preset, or its file is damaged; the message says which are there.
        """
        return cls.from_toml(preset_path(_PRESET_FOLDER, name, "array"))

    @classmethod
    def from_toml(cls, path: Path) -> TransducerArray:
        """Read an array from a TOML file.

        Its ``[array]`` table holds fields of this class; the transducers' places come from a
        ``[grid]`` table with columns, rows, pitch [m] and missing, or from positions and normals.

        Raises:
            ValueError: The file is not valid TOML, a key is unknown or a value does not fit.
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
