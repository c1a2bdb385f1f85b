# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs in autd3's environment: its GS-PAT for sets of foci, and its emulator's field of drives.

``python autd3_field.py SCENE.npz RESULT.npz``. autd3 uses millimeters; the files use meters.
"""

import sys
import time

import numpy as np
from autd3.commands import Pattern, SetSilencer
from autd3_core import Autd3, Duration, Geometry, Velocity
from autd3_emulator import Emulator, Grid, RmsRecordOption
from autd3_pattern import wavelength
from autd3_pattern_holo import (
    AmplitudeTarget,
    Directivity,
    GspatOption,
    IntensityConstraint,
    Pa,
    gspat,
)

scene = np.load(sys.argv[1])
speed = Velocity.from_m_s(float(scene["speed_of_sound"]))
geometry = Geometry([Autd3()])
positions = np.asarray(geometry.device(0).positions(), float)
# The foci are relative to the center of the grid.
middle = 0.5 * (positions.min(0) + positions.max(0))

phases, intensities = geometry.phase_buffer(), geometry.intensity_buffer()
option = GspatOption(
    constraint=IntensityConstraint.Clamp(0, 255), directivity=Directivity.Sphere, parallel=False
)
solved_phases, solved_intensities, seconds = [], [], []
begin = 0
for size in scene["sizes"]:
    part = slice(begin, begin + size)
    begin += size
    targets = [
        AmplitudeTarget(1e3 * point + middle, float(pressure) * Pa)
        for point, pressure in zip(scene["points"][part], scene["pressures"][part], strict=True)
    ]
    start = time.perf_counter()
    gspat(geometry, targets, wavelength(speed), option, phases, intensities)
    seconds.append(time.perf_counter() - start)
    solved_phases.append(phases.to_numpy()[0].copy())
    solved_intensities.append(intensities.to_numpy()[0].copy())

fields = []
for drive_phases, drive_intensities, point in zip(
    scene["phases"], scene["intensities"], scene["probes"], strict=True
):
    phases.copy_from(drive_phases[None])
    intensities.copy_from(drive_intensities[None])

    def play(recorder):
        """Emit the drive for a millisecond."""
        recorder.send(SetSilencer.disable())
        recorder.send(Pattern(phases, intensities))
        recorder.tick(Duration.from_millis(1))

    record = Emulator(geometry).record(play)
    x, y, z = (float(value) for value in 1e3 * point + middle)
    field = record.sound_field(
        Grid(x=(x, x + 0.2), y=y, z=z, resolution=0.2, order="xyz"), RmsRecordOption(speed)
    )
    place = field.observe_points().to_numpy()[0]
    fields.append(
        (*(1e-3 * (place - middle)), field.next(Duration.from_millis(1)).to_numpy()[0, -1])
    )
np.savez(
    sys.argv[2],
    positions=1e-3 * (positions - middle),
    phases=np.array(solved_phases),
    intensities=np.array(solved_intensities),
    seconds=np.array(seconds),
    fields=np.array(fields),
)
