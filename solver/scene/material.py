# SPDX-License-Identifier: GPL-3.0-or-later
"""What a clay is made of, in SI units, and the presets that ship with the project."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

PRESET_FOLDER = Path(__file__).resolve().parents[2] / "presets" / "materials"
"""Where the materials are that ship with the project."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """An elastoplastic, viscous, frictional clay.

    How far the solver carries these values is said in the *Limitations* of `Solver`.

    Raises:
        ValueError: A value is not finite or lies outside its range; the message names it.
    """

    density: float = 1700.0
    """Mass density at rest [kg/m³]."""
    yield_stress: float = 5e3
    """Shear stress at which the clay starts to flow [Pa] (uniaxial: √3 times as much)."""
    viscosity: float = 200.0
    """Resistance to flow beyond the yield stress [Pa·s], or with a flow index n its consistency
    [Pa·sⁿ]: the shear stress of flowing clay is τ_y + K γ̇ⁿ (Herschel and Bulkley 1926)."""
    flow_index: float = 1.0
    """Power n of the strain rate: 1 for a Bingham material, below 1 where flow thins it."""
    shear_modulus: float = 2.5e5
    """Elastic shear modulus below the yield stress [Pa]. Real clay has 50 to 300 times its yield
    stress; a dent of mean pressure 6 τ_y springs back by some 3 τ_y / G of the tool's radius."""
    friction: float = 0.5
    """Coulomb friction coefficient; a contact takes the geometric mean of clay and collider."""
    cohesion: float | None = None
    """Tension [Pa] at which bonds give way and draw out; the yield stress where not given,
    0 for a material that falls apart like sand."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None:
                continue
            lowest_allowed = field.name in ("viscosity", "friction", "cohesion", "yield_stress")
            if not math.isfinite(value) or value < 0 or (value == 0 and not lowest_allowed):
                bound = "at least 0" if lowest_allowed else "greater than 0"
                raise ValueError(
                    f"Material.{field.name} is {value!r}; it must be a number {bound}."
                )

    @property
    def tension_limit(self) -> float:
        """Tension at which bonds draw out [Pa]."""
        return self.yield_stress if self.cohesion is None else self.cohesion

    @classmethod
    def preset_names(cls) -> list[str]:
        """Names that `preset` knows, sorted."""
        return sorted(path.stem for path in PRESET_FOLDER.glob("*.toml"))

    @classmethod
    def preset(cls, name: str) -> Material:
        """Read a material that ships with the project (``presets/materials/*.toml``).

        Raises:
            ValueError: No such preset, or its file is damaged; the message says which are there.
        """
        if name not in cls.preset_names():
            known = ", ".join(cls.preset_names())
            raise ValueError(f"There is no material preset {name!r}. There are: {known}.")
        return cls.from_toml(PRESET_FOLDER / f"{name}.toml")

    @classmethod
    def from_toml(cls, path: Path) -> Material:
        """Read a material from a TOML file with a ``[material]`` table.

        Raises:
            ValueError: The file is no TOML, or a key is unknown or has no number.
            OSError: The file cannot be read.
        """
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8")).get("material")
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path.name} is not a valid TOML file: {error}.") from error
        if not isinstance(table, dict):
            raise ValueError(f"{path.name} has no [material] table.")
        known = {field.name for field in fields(cls)}
        values: dict[str, float] = {}
        for key, value in table.items():
            if key not in known:
                raise ValueError(
                    f"{path.name}: unknown key {key!r}. Known keys: {', '.join(sorted(known))}."
                )
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"{path.name}: {key} is {value!r}; it must be a number.")
            values[key] = float(value)
        return cls(**values)
