# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the comparison scene in SPlisHSPlasH, in its own environment.

It has no clay. A viscous fluid is used instead, set up like its own scenes of buckling fluids:
position based fluids with the implicit viscosity of Weiler et al. 2018, chosen so that the stress
around the ball is that of the clay. Time steps follow its Courant condition. Boundaries are
particles after Akinci et al. 2012; they lie half a spacing below the surfaces that they represent,
because they keep others a whole spacing away. The force on a body is summed internally but not
accessible from Python, so none is reported.

    python peer_splishsplash.py scene.npz result.npz
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pysplishsplash as sph


def material(scene: dict[str, np.ndarray]) -> dict[str, Any]:
    """The fluid used instead of clay."""
    # The strain rate around the ball is its speed over its radius.
    viscosity = float(scene["yield_stress"] * scene["radius"] / scene["speed"])
    return {
        "id": "Fluid",
        "density0": float(scene["density"]),
        "surfaceTensionMethod": 0,
        "viscosityMethod": 6,
        "Weiler et al. 2018": {
            "viscosity": viscosity,
            "viscosityBoundary": viscosity,
            "viscoMaxIter": 200,
            "viscoMaxError": 0.05,
        },
    }


def describe(scene: dict[str, np.ndarray]) -> dict[str, Any]:
    """The scene as SPlisHSPlasH reads it."""
    models = Path(sys.executable).parent / "data" / "models"
    points, half = scene["points"], 0.52 * float(scene["spacing"])
    # Distance of boundary particles below the surface.
    below = 0.5 * float(scene["spacing"])
    radius = float(scene["radius"]) - below
    size = 4.0 * float(points[:, 0].max())

    def body(mesh: str, place: list[float], scale: list[float], moves: bool) -> dict[str, Any]:
        return {
            "geometryFile": str(models / mesh),
            "translation": place,
            "scale": scale,
            "isDynamic": False,
            "isWall": False,
            "isAnimated": moves,
        }

    return {
        "Configuration": {
            "timeStepSize": 0.001,
            "particleRadius": 0.5 * float(scene["spacing"]),
            "simulationMethod": 2,
            "gravitation": [0.0, 0.0, -9.81],
            "cflMethod": 1,
            "cflFactor": 1,
            "cflMaxTimeStepSize": 0.005,
            "boundaryHandlingMethod": 0,
        },
        "Materials": [material(scene)],
        "RigidBodies": [
            body("UnitBox.obj", [0.0, 0.0, -0.02 - below], [size, size, 0.04], False),
            body("sphere.obj", [0.0, 0.0, float(scene["heights"][0])], [radius] * 3, True),
        ],
        "FluidBlocks": [
            {
                "id": "Fluid",
                "denseMode": 0,
                "start": (points.min(0) - 2.0 * half).tolist(),
                "end": (points.max(0) + 2.0 * half).tolist(),
            }
        ],
    }


class Recorder:
    """Moves the ball before each step, and records the cost and positions of frames."""

    def __init__(self, scene: dict[str, np.ndarray]) -> None:
        self.scene = scene
        self.frame = float(scene["frame"])
        self.heights = scene["heights"]
        self.done = 0
        self.begin = (time.process_time(), time.perf_counter())
        self.cores: list[float] = []
        self.walls: list[float] = []
        self.positions: list[np.ndarray] = []
        self.order: np.ndarray | None = None

    def height(self, moment: float) -> float:
        """Height of the ball's center [m] at a time [s]."""
        ends = self.frame * np.arange(1, len(self.heights) + 1)
        return float(np.interp(moment, ends, self.heights))

    def step(self) -> None:
        """Callback before each step."""
        now = sph.TimeManager.getCurrent()
        while self.done < len(self.heights) and now.getTime() >= (self.done + 1) * self.frame:
            ended = (time.process_time(), time.perf_counter())
            self.cores.append(ended[0] - self.begin[0])
            self.walls.append(ended[1] - self.begin[1])
            if self.done in self.scene["snapshots"]:
                self.positions.append(self.read())
            self.done += 1
            self.begin = (time.process_time(), time.perf_counter())
        ball = sph.Simulation.getCurrent().getBoundaryModel(1).getRigidBodyObject()
        step = now.getTimeStepSize()
        offset = self.height(now.getTime() + step) - float(ball.getPosition()[2])
        ball.setVelocity([0.0, 0.0, offset / step])
        ball.animate()

    def read(self) -> np.ndarray:
        """Positions in the order of the scene's points [m], shape [N, 3]."""
        fluid = sph.Simulation.getCurrent().getFluidModel(0)
        count = fluid.numActiveParticles()
        by_number = np.empty((count, 3))
        start = np.empty((count, 3))
        for place in range(count):
            number = fluid.getParticleId(place)
            by_number[number] = fluid.getPosition(place)
            start[place] = fluid.getPosition0(place)
        if self.order is None:
            cells = np.floor((start - start.min(0)) / float(self.scene["spacing"]) + 0.5)
            self.order = np.lexsort(cells.T[::-1])
        return by_number[self.order]


def run(scene: dict[str, np.ndarray]) -> dict[str, Any]:
    """Run the scene."""
    recorder = Recorder(scene)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scene.json")
        path.write_text(json.dumps(describe(scene)), encoding="utf-8")
        base = sph.Exec.SimulatorBase()
        base.init(
            useGui=False, sceneFile=str(path), initialPause=False, outputDir=folder, useCache=False
        )
        base.initSimulation()
        count = sph.Simulation.getCurrent().getFluidModel(0).numActiveParticles()
        if count != len(scene["points"]):
            raise RuntimeError(
                f"SPlisHSPlasH made {count} particles instead of {len(scene['points'])}."
            )
        base.setTimeStepCB(recorder.step)
        base.setValueFloat(base.STOP_AT, recorder.frame * (len(scene["heights"]) + 1))
        base.runSimulation()
    frames = len(scene["heights"])
    return {
        "positions": np.array(recorder.positions),
        "forces": np.full(frames, math.nan),
        "core_seconds": np.array(recorder.cores[:frames]),
        "wall_seconds": np.array(recorder.walls[:frames]),
    }


if __name__ == "__main__":
    np.savez(sys.argv[2], **run(dict(np.load(sys.argv[1]))))
    sys.stdout.flush()
    # Its destructors crash without a window.
    os._exit(0)
