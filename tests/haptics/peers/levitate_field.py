# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs in levitate's environment: the pressure of each transducer at points, by its formulas.

``python levitate_field.py SCENE.npz RESULT.npz``
"""

import sys

import numpy as np
from levitate.arrays import RectangularArray
from levitate.transducers import CircularPiston

scene = np.load(sys.argv[1])
piston = CircularPiston(effective_radius=float(scene["radius"]), p0=float(scene["p0"]))
array = RectangularArray(
    shape=int(scene["columns"]), spread=float(scene["pitch"]), transducer=piston
)
transfer = array.pressure_derivs(scene["points"].T, orders=0)[0].T
np.savez(
    sys.argv[2],
    positions=array.positions.T,
    speed_of_sound=array.medium.c,
    transfer=transfer,
)
