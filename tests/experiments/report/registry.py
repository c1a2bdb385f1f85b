# SPDX-License-Identifier: GPL-3.0-or-later
"""The experiments of the report, with the figures by which each is judged.

To add one, write it as a function in a module beside this folder, and add an entry.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from tactile_clay.solver import Material, Settings
from tactile_clay.tests.experiments.bounce import Bounce, bounce
from tactile_clay.tests.experiments.compression import compress_cylinder
from tactile_clay.tests.experiments.couette import Couette, couette
from tactile_clay.tests.experiments.coulomb import creep, drag, stop
from tactile_clay.tests.experiments.cut import cut
from tactile_clay.tests.experiments.elastic import STIFFNESS_OVER_SHEAR, Elastic, compress, shear
from tactile_clay.tests.experiments.falling import drop, free_fall
from tactile_clay.tests.experiments.merge import merge
from tactile_clay.tests.experiments.motion import collision, spin
from tactile_clay.tests.experiments.poiseuille import Poiseuille, poiseuille
from tactile_clay.tests.experiments.press import Press, press
from tactile_clay.tests.experiments.pull import pull
from tactile_clay.tests.experiments.resting import rest
from tactile_clay.tests.experiments.slump import Slump, slump
from tactile_clay.tests.experiments.squeeze import squeeze
from tactile_clay.tests.experiments.standing import GRAVITY, stand
from tactile_clay.tests.experiments.thread import hang
from tactile_clay.tests.experiments.wheel import spin_disc, turn_wheel

from .experiment import SPACING, Experiment
from .figure import Figure


def _press(material: Material, radius: float = 0.02) -> Callable[[Settings, float], Press]:
    """Press a ball as deep as its radius into a block five radii wide and four high."""

    def run(settings: Settings, spacing: float) -> Press:
        across, high = round(5.0 * radius / spacing), round(4.2 * radius / spacing)
        return press(
            radius,
            radius=radius,
            spacing=spacing,
            counts=(across, across, high),
            material=material,
            settings=settings,
        )

    return run


def _slump(ratio: float) -> Callable[[Settings, float], Slump]:
    """Let a 60 mm cylinder slump whose yield stress is ``ratio`` times ρ g H."""
    return lambda settings, spacing: slump(ratio, layers=round(0.06 / spacing), settings=settings)


def _shear(modulus: float) -> Callable[[Settings, float], Elastic]:
    """Shear a block with a given modulus [Pa]."""
    return lambda settings, spacing: shear(
        material=Material(shear_modulus=modulus), settings=settings
    )


def _couette(rate: float, viscosity: float) -> Callable[[Settings, float], Couette]:
    """Shear clay between rough plates to a strain of two."""
    material = Material(viscosity=viscosity)
    return lambda settings, spacing: couette(rate, 2.0, material=material, settings=settings)


def _flow_ratio(result: Couette) -> float:
    rate, stress = result.flow(1.0)
    return stress / (result.material.yield_stress + result.material.viscosity * rate)


def _film(ratio: float, index: float) -> Callable[[Settings, float], Poiseuille]:
    """Let a layer of ten particles flow down an incline."""
    viscosity = 200.0 if index == 1.0 else 400.0
    return lambda settings, spacing: poiseuille(
        ratio, viscosity=viscosity, flow_index=index, settings=settings
    )


def _uniaxial(result: Elastic) -> tuple[float, float]:
    """Force of a block compressed between plates, for a modulus of 2.5 to 3 G [N]."""
    unit = result.expected / (0.5 * sum(STIFFNESS_OVER_SHEAR))
    return unit * STIFFNESS_OVER_SHEAR[0], unit * STIFFNESS_OVER_SHEAR[1]


def _contact_time(result: Bounce) -> float:
    return result.contact_time / result.expected_time


def _moving(result: Press) -> tuple[float, float]:
    low, high = result.theory
    return low + result.viscous, high + result.viscous


_SLIP_LINE = (
    "slip-line theory of a round punch: 5.7 to 6.05 τ_y A (Hill 1950; Levin 1955); 8 η a v more "
    "while moving"
)
_PRESS = (
    Figure("force moving", "force_moving", _moving, 0.15, "N", relative=True),
    Figure("force held", "force_held", lambda r: r.theory, 0.15, "N", relative=True),
    Figure("spring-back", "spring_back", 0.0, 0.10),
    Figure("compression left", "compression_left", 0.0, 0.01),
    Figure("penetration, in spacings", lambda r: r.max_penetration / SPACING, 0.0, 0.1),
)
_SLUMP = (Figure("slump over height", "measured", lambda r: (r.pashias, r.von_mises), 0.05),)
_PASHIAS = "Pashias et al. 1996 to the same for von Mises; tolerance 5 % of the height"
_COULOMB = GRAVITY * (math.sin(math.radians(35)) - 0.6 * math.cos(math.radians(35)))
_SLOPE = math.radians(15)

EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        "free fall",
        lambda s, d: free_fall(settings=s),
        (
            Figure("depth", "fallen", lambda r: r.expected, 1e-3, "m", relative=True),
            Figure("distortion", "distortion", 0.0, 1e-6, "m"),
        ),
        "½ g t²",
    ),
    Experiment(
        "drop",
        lambda s, d: drop(settings=s),
        (
            Figure("impulse over m g t", "impulse_ratio", 1.0, 0.02),
            Figure("height kept", "height_ratio", 1.0, 0.03),
        ),
        "momentum balance",
        swept=True,
        quick=True,
    ),
    Experiment(
        "spin",
        lambda s, d: spin(settings=s),
        (
            Figure("spin kept", "spin_kept", 1.0, 0.01),
            Figure("radius over radius before", "radius_ratio", 1.0, 0.01),
            Figure("linear momentum", "momentum", 0.0, 1e-5),
            Figure("change of spin in a step", "spin_change_per_step", 0.0, 1e-4),
        ),
        "a free body keeps both momenta",
        swept=True,
    ),
    Experiment(
        "collision",
        lambda s, d: collision(settings=s),
        (
            Figure("linear momentum change in a step", "momentum_change_per_step", 0.0, 1e-5),
            Figure("angular momentum change in a step", "spin_change_per_step", 0.0, 1e-4),
        ),
        "both momenta are kept",
    ),
    Experiment(
        "rest",
        lambda s, d: stand(settings=s),
        (
            Figure("weight over m g", "normal_force", 1.0, 0.01),
            Figure("drift in a second, in spacings", lambda r: r.drift / SPACING, 0.0, 0.01),
        ),
        "statics",
        swept=True,
        quick=True,
    ),
    Experiment(
        "incline of 15°",
        lambda s, d: stand(_SLOPE, friction=0.6, settings=s),
        (
            Figure("slip in a second", lambda r: abs(r.slip) * 1e3, 0.0, 1.0 / 60.0, "mm"),
            Figure("force along over m g", "tangential_force", math.sin(_SLOPE), 0.02, "", True),
            Figure("force across over m g", "normal_force", math.cos(_SLOPE), 0.02, "", True),
        ),
        "Coulomb, μ = 0.6: it sticks; tolerance 1 mm a minute",
        swept=True,
    ),
    Experiment(
        "incline of 35°",
        lambda s, d: stand(math.radians(35), friction=0.6, settings=s),
        (Figure("acceleration", "acceleration", _COULOMB, 0.03, "m/s²", relative=True),),
        "Coulomb, μ = 0.6: g (sin θ − μ cos θ)",
        swept=True,
        quick=True,
    ),
    *(
        Experiment(
            f"slump, τ′ = {ratio}",
            _slump(ratio),
            _SLUMP,
            _PASHIAS,
            swept=True,
            spacings=(0.006, 0.008, 0.004),
        )
        for ratio in (0.1, 0.2, 0.3)
    ),
    *(
        Experiment(
            "press, 5 kPa" + (f", spacing {1e3 * spacing:g} mm" if spacing != SPACING else ""),
            _press(Material()),
            _PRESS,
            _SLIP_LINE,
            spacings=(spacing,),
        )
        for spacing in (0.005, 0.007, 0.0035)
    ),
    Experiment(
        "press, 1 kPa",
        _press(Material(yield_stress=1e3, viscosity=20.0, shear_modulus=5e4)),
        _PRESS,
        _SLIP_LINE,
    ),
    Experiment(
        "press, 25 kPa",
        _press(Material(yield_stress=25e3, shear_modulus=1.25e6)),
        _PRESS,
        _SLIP_LINE,
    ),
    Experiment(
        "press, 5 kPa, small ball",
        _press(Material(), radius=0.012),
        _PRESS,
        _SLIP_LINE,
        swept=True,
        spacings=(0.005, 0.007, 0.0035),
    ),
    *(
        Experiment(
            f"shear flow, {viscosity:g} Pa s at {rate:g} /s",
            _couette(rate, viscosity),
            (Figure("stress over τ_y + η γ̇", _flow_ratio, 1.0, 0.05),),
            "Bingham fluid between rough plates (Couette)",
        )
        for rate, viscosity in ((2.0, 20.0), (5.0, 200.0), (10.0, 400.0))
    ),
    *(
        Experiment(
            f"film, yield ratio {ratio:g}, index {index:g}",
            _film(ratio, index),
            (Figure("speed of the plug over theory", "plug", 1.0, 0.05),),
            "Herschel-Bulkley fluid down a rough incline (half of plane Poiseuille flow)",
        )
        for ratio, index in ((0.0, 1.0), (0.25, 1.0), (0.5, 1.0), (0.25, 0.5))
    ),
    Experiment(
        "merge",
        lambda s, d: merge(settings=s),
        (Figure("rise of the lower block over the lift", lambda r: r.lower / r.lift, 1.0, 0.1),),
        "two blocks pressed 5 mm together are one",
        swept=True,
    ),
    Experiment(
        "merge without cohesion",
        lambda s, d: merge(material=Material(cohesion=0.0), settings=s),
        (Figure("rise of the lower block over the lift", lambda r: r.lower / r.lift, 0.0, 0.1),),
        "without tensile strength the lower block stays",
    ),
    Experiment(
        "knife",
        lambda s, d: cut(settings=s),
        (
            Figure("pieces before", "pieces_before", 1.0, 0.5),
            Figure("pieces after", "pieces_after", 2.0, 0.5),
            Figure("debris, particles", "debris", 0.0, 4.0),
            Figure("smaller piece over larger", "evenness", (0.9, 1.0), 0.1),
        ),
        "two merged blocks are split at their joint",
    ),
    Experiment(
        "pull",
        lambda s, d: pull(settings=s),
        (
            Figure("stretch at breaking", "stretch", (1.5, math.inf), 0.1),
            Figure("pieces", "piece_count", 2.0, 0.5),
            Figure("debris, particles", "debris", 0.0, 8.0),
            Figure("largest pull over √3 τ_y A", "force_ratio", 1.0, 0.15),
        ),
        "a ductile bar necks beyond 1.5 times its length and breaks in two",
        swept=True,
    ),
    *(
        Experiment(
            f"shear, {modulus / 1e3:g} kPa",
            _shear(modulus),
            (
                Figure("force over G γ A", "ratio", 1.0, 0.15),
                Figure("deformation recovered", "returned", 1.0, 0.02),
            ),
            "elasticity below yield: G γ A",
        )
        for modulus in (2e4, 1e5, 4e5)
    ),
    Experiment(
        "elastic compression",
        lambda s, d: compress(settings=s),
        (
            Figure("force", "force", _uniaxial, 0.15, "N", relative=True),
            Figure("deformation recovered", "returned", 1.0, 0.02),
        ),
        "elasticity below yield: 2.5 to 3 G ε A",
    ),
    Experiment(
        "bounce",
        lambda s, d: bounce(settings=s),
        (
            Figure("contact time over 2 H / c", _contact_time, 1.0, 0.2),
            Figure("restitution", "restitution", 1.0, 0.25),
        ),
        "a wave through a stiff elastic block and back",
        swept=True,
    ),
    Experiment(
        "compressed cylinder",
        lambda s, d: compress_cylinder(settings=s),
        (Figure("force over √3 τ_y A", "ratio", 1.0, 0.1),),
        "plastic cylinder between plates: frictionless √3 τ_y A",
    ),
    Experiment(
        "compressed cylinder, sticking",
        lambda s, d: compress_cylinder(sticking=True, settings=s),
        (Figure("force over theory", "ratio", 1.0, 0.1),),
        "plastic cylinder between plates: sticking √3 τ_y A (1 + 2 R / 3 √3 h)",
    ),
    Experiment(
        "dragged block",
        lambda s, d: drag(settings=s),
        (
            Figure("friction of the table over μ m g", "table_ratio", 1.0, 0.02),
            Figure("force of the paddle over μ m g", "paddle_ratio", 1.0, 0.02),
        ),
        "Coulomb: μ m g",
    ),
    Experiment(
        "stopping block",
        lambda s, d: stop(settings=s),
        (Figure("distance", "distance", lambda r: r.expected, 0.03, "m", relative=True),),
        "Coulomb: v² / 2 μ g",
    ),
    Experiment(
        "creep at 25.57°",
        lambda s, d: creep(math.radians(25.57), friction=0.5, settings=s),
        (Figure("creep", lambda r: 6e4 * abs(r), 0.0, 1.0, "mm/min"),),
        "Coulomb, μ = 0.5: it sticks up to 26.57°",
    ),
    Experiment(
        "wheel at 100 rpm",
        lambda s, d: turn_wheel(settings=s),
        (
            Figure("rotation over the wheel's", "turn_ratio", 1.0, 0.01),
            Figure("radius kept", "radius_ratio", 1.0, 0.01),
            Figure("weight over m g", "weight_ratio", 1.0, 0.01),
        ),
        "a sticking block turns with the wheel",
    ),
    Experiment(
        "disc at 300 of 373 rpm",
        lambda s, d: spin_disc(settings=s),
        (
            Figure("radius over radius before", "radius_ratio", 1.0, 0.05),
            Figure("spin kept", "spin_kept", 1.0, 0.01),
        ),
        "a thin disc withstands up to ρ ω² R² = 3 σ_Y",
    ),
    Experiment(
        "hanging thread, 0.7 of its limit",
        lambda s, d: hang(0.7, settings=s),
        (
            Figure("stretch", "stretch", 0.0, 0.05),
            Figure("pieces", "piece_count", 1.0, 0.5),
        ),
        "a thread holds its weight up to a length of √3 τ_y / ρ g",
    ),
    Experiment(
        "rest of 10,000 steps",
        lambda s, d: rest(settings=s),
        (
            Figure("drift, in spacings", "drift", 0.0, 0.01),
            Figure("volume change", "volume_change", 0.0, 0.01),
            Figure("weight over m g", lambda r: r.weight_ratios[1], 1.0, 0.01),
        ),
        "a block at rest does not change",
    ),
    Experiment(
        "100 squeezes",
        lambda s, d: squeeze(settings=s),
        (
            Figure("volume change inside the surface", "surface_change", 0.0, 0.01),
            Figure("compression left", "compression_change", 0.0, 0.01),
            Figure("pieces", "pieces", 1.0, 0.5),
        ),
        "volume is kept within 1 %",
    ),
)


def find(name: str) -> Experiment:
    """Find an experiment by name."""
    return next(experiment for experiment in EXPERIMENTS if experiment.name == name)
