# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of clay in SI units, and the presets that ship with the project."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ..core.preset_files import check_keys, preset_names, preset_path, read_tables

PRESET_FOLDER = Path(__file__).resolve().parents[2] / "presets" / "materials"
"""Folder of the presets that ship with the project."""


@dataclass(frozen=True)
class MaterialField:
    """One value of a `Material`, as interfaces, files and checks need to know it."""

    name: str
    """Name of the attribute, and key in files."""
    label: str
    """Name shown to users, without unit."""
    unit: str
    """SI unit; empty for a pure number."""
    description: str
    """Tooltip, one line."""
    default: float | None
    """Default value; None if the value follows from another when not given."""
    minimum: float
    """Smallest value in interfaces and in files of materials."""
    soft_maximum: float
    """Upper end of sliders; larger values can be typed."""
    positive: bool
    """Whether the value must be greater than zero."""

    @property
    def is_optional(self) -> bool:
        """Whether the value may be omitted."""
        return self.default is None

    @property
    def label_with_unit(self) -> str:
        """Name shown to users with unit, such as ``Viscosity (Pa·s)``."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


def _value(
    default: float | None,
    label: str,
    unit: str,
    description: str,
    *,
    minimum: float = 0.0,
    soft_maximum: float,
    positive: bool = False,
) -> Any:
    """A field of `Material` with its metadata for `MATERIAL_FIELDS`."""
    about = {
        "default": default,
        "label": label,
        "unit": unit,
        "description": description,
        "minimum": minimum,
        "soft_maximum": soft_maximum,
        "positive": positive,
    }
    return field(default=default, metadata=about)


@dataclass(frozen=True, kw_only=True)
class Material:
    """An elastoplastic, viscous, frictional clay.

    The *Limitations* of `Solver` tell how accurately these values are reproduced.

    Raises:
        ValueError: A value is not finite or lies outside its range; the message names it.
    """

    density: float = _value(
        1700.0,
        "Density",
        "kg/m³",
        "Mass per cubic meter at rest",
        minimum=1.0,
        soft_maximum=1e4,
        positive=True,
    )
    """Mass density at rest [kg/m³]."""
    yield_stress: float = _value(
        5e3, "Yield Stress", "Pa", "Shear stress at which the clay starts to flow", soft_maximum=1e5
    )
    """Shear stress at which the clay starts to flow [Pa] (uniaxial: √3 times as much)."""
    viscosity: float = _value(
        200.0,
        "Viscosity",
        "Pa·s",
        "Resistance to flow beyond the yield stress; the consistency if the flow index is not 1",
        soft_maximum=5e3,
    )
    """Resistance to flow beyond the yield stress [Pa·s], or with a flow index n the consistency
    [Pa·sⁿ]: the shear stress of flowing clay is τ_y + K γ̇ⁿ (Herschel and Bulkley 1926)."""
    flow_index: float = _value(
        1.0,
        "Flow Index",
        "",
        "Exponent of the strain rate: 1 for a Bingham material, below 1 for shear thinning",
        minimum=0.1,
        soft_maximum=1.0,
        positive=True,
    )
    """Exponent n of the strain rate: 1 for a Bingham material, below 1 for shear thinning."""
    shear_modulus: float = _value(
        2.5e5,
        "Shear Modulus",
        "Pa",
        "Stiffness below the yield stress",
        minimum=1.0,
        soft_maximum=1e6,
        positive=True,
    )
    """Elastic shear modulus below the yield stress [Pa]. Real clay has 50 to 300 times its yield
    stress; a dent of mean pressure 6 τ_y springs back by some 3 τ_y / G of the tool's radius."""
    friction: float = _value(
        0.5,
        "Friction",
        "",
        "Coulomb friction coefficient; contacts use the geometric mean of clay and collider",
        soft_maximum=1.0,
    )
    """Coulomb friction coefficient; contacts use the geometric mean of clay and collider."""
    cohesion: float | None = _value(
        None,
        "Cohesion",
        "Pa",
        "Tension at which the clay draws out and tears; if off, equal to the yield stress",
        soft_maximum=1e5,
    )
    """Tension [Pa] at which bonds yield and draw out; by default the yield stress, 0 for a material
    that falls apart like sand."""

    def __post_init__(self) -> None:
        for each in MATERIAL_FIELDS:
            value = getattr(self, each.name)
            if value is None and each.is_optional:
                continue
            if not math.isfinite(value) or value < 0 or (value == 0 and each.positive):
                bound = "greater than 0" if each.positive else "at least 0"
                raise ValueError(f"Material.{each.name} is {value!r}; it must be a number {bound}.")

    @property
    def tension_limit(self) -> float:
        """Tension at which bonds draw out [Pa]."""
        return self.yield_stress if self.cohesion is None else self.cohesion

    @classmethod
    def preset_names(cls) -> list[str]:
        """Names that `preset` knows, sorted."""
        return preset_names(PRESET_FOLDER)

    @classmethod
    def preset(cls, name: str) -> Material:
        """Read a material that ships with the project (``presets/materials/*.toml``).

        Raises:
            ValueError: There is no such preset (the message lists all), or its file is damaged.
        """
        return cls.from_toml(preset_path(PRESET_FOLDER, name, "material"))

    @classmethod
    def from_toml(cls, path: Path) -> Material:
        """Read a material from a TOML file with a ``[material]`` table.

        Raises:
            ValueError: The file is not valid TOML, or a key is unknown or its value invalid.
            OSError: The file cannot be read.
        """
        table = read_tables(path, "material")["material"]
        check_keys(path, table, {each.name for each in MATERIAL_FIELDS})
        values: dict[str, float] = {}
        for key, value in table.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"{path.name}: {key} is {value!r}; it must be a number.")
            values[key] = float(value)
        return cls(**values)

    def to_toml(self) -> str:
        """The ``[material]`` table of a file that `from_toml` reads."""
        values = [(each.name, getattr(self, each.name)) for each in MATERIAL_FIELDS]
        lines = [f"{name} = {float(value)!r}\n" for name, value in values if value is not None]
        return "".join(["[material]\n", *lines])


MATERIAL_FIELDS = tuple(MaterialField(name=each.name, **each.metadata) for each in fields(Material))
"""The values of a material, in the order shown to users."""
