# SPDX-License-Identifier: GPL-3.0-or-later
"""Elastic flesh on bones, which relaxes towards equilibrium with its loads.

Flesh is light and heavily damped, so inertia is neglected. A solve is one Newton step by conjugate
gradients.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..hand.rig import HandRig
from .elasticity import FleshData, assemble_tangent, carry_nodes, measure_stress, sum_inner_forces
from .pattern import block_pattern, incidences, sum_by_block
from .rest import FleshRest
from .solve import (
    FleshSolve,
    advance_solve,
    balance_forces,
    move_nodes,
    multiply,
    start_solve,
    take_load,
    turn_direction,
)

MAX_STEP = 0.01
"""Largest motion of a node in a solve, relative to the size of the hand."""
RELAXATION_TIME = 0.008
"""Time constant with which flesh follows its loads [s]."""


def yielded_part(time_step: float) -> float:
    """Fraction of the change to equilibrium that flesh completes in a time step [s]."""
    return time_step / (time_step + RELAXATION_TIME)


class Flesh:
    """The flesh of one hand on the device.

    *Limitations*: strain is linear after removing rotation, so flesh compressed to less than half
    its thickness is softer than real flesh. Linear tetrahedra are too stiff in bending and when
    nearly incompressible. Skin is not stiffer than flesh, and has no self-contact.

    Args:
        rig: The hand.
        rest: Its flesh at rest, from `flesh_rest`.
        young_modulus: Young's modulus [Pa].
        poisson_ratio: Poisson's ratio, below 0.5.
        iterations: Conjugate-gradient iterations per solve.
        device: Warp device.
    """

    def __init__(
        self,
        rig: HandRig,
        rest: FleshRest,
        *,
        young_modulus: float,
        poisson_ratio: float,
        iterations: int,
        device: wp.Device,
    ) -> None:
        self.device = device
        self.count = len(rig.nodes)
        self.iterations = iterations
        shear = young_modulus / (2.0 * (1.0 + poisson_ratio))
        first = 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
        tetrahedra = rig.tetrahedra.astype(np.int32)
        row, column, share, part = block_pattern(tetrahedra, self.count)
        data = FleshData()
        data.lame = wp.vec2(first, shear)
        data.young_modulus = young_modulus
        data.max_step = MAX_STEP * float(np.linalg.norm(np.ptp(rig.nodes, axis=0)))

        def put(values: NDArray, dtype: Any) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        def zeros(count: int, dtype: Any) -> wp.array:
            return wp.zeros(count, dtype=dtype, device=device)

        data.tetrahedron = put(tetrahedra, wp.vec4i)
        data.gradient = put(rest.gradients, wp.vec3)
        data.volume = put(rest.volumes, float)
        data.rest = put(rig.nodes, wp.vec3)
        data.bone = put(rig.node_bones, wp.vec4i)
        data.weight = put(rig.node_weights, wp.vec4)
        foundation = sum_by_block(rest.bone_shares, tetrahedra, row, column, share, part)
        data.foundation = put(young_modulus / rest.foundation_length**2 * foundation, float)
        data.skinning = put(np.tile(np.eye(4), (len(rig.bone_names), 1, 1)), wp.mat44)
        data.bone_frame = put(np.tile((0.0, 0.0, 0.0, 1.0), (len(rig.bone_names), 1)), wp.quat)
        data.position = put(rig.nodes, wp.vec3)
        data.carried = put(rig.nodes, wp.vec3)
        data.frame = put(np.tile((0.0, 0.0, 0.0, 1.0), (self.count, 1)), wp.quat)
        data.inner = zeros(self.count, wp.vec3)
        data.turned_gradient = wp.zeros_like(data.gradient)
        data.traction = wp.zeros_like(data.gradient)
        data.stiffening = zeros(len(tetrahedra), wp.vec2)
        data.row, data.column = put(row, int), put(column, int)
        data.share, data.part = put(share, int), put(part, wp.vec3i)
        data.block = zeros(len(column), wp.mat33)
        data.inverse = zeros(self.count, wp.mat33)
        data.touching = put(incidences(tetrahedra, self.count), wp.vec2i)
        self.data = data
        solve = FleshSolve()
        for name in ("residual", "z", "direction", "product", "change"):
            setattr(solve, name, zeros(self.count, wp.vec3))
        solve.size = zeros(iterations + 1, wp.float64)
        solve.curvature = zeros(iterations, wp.float64)
        self.solve_data = solve

    def carry(self) -> None:
        """Move the nodes with the bones to the poses in ``skinning``."""
        self._launch(carry_nodes, self.data)

    def stretch(self) -> None:
        """Compute stress and internal forces at the current positions."""
        tetrahedra = len(self.data.volume)
        wp.launch(measure_stress, dim=tetrahedra, inputs=[self.data], device=self.device)
        self._launch(sum_inner_forces, self.data)

    def stiffen(self) -> None:
        """Compute the tangent stiffness for that stress."""
        self._launch(assemble_tangent, self.data)

    def relax(self, load: wp.array, part: float) -> None:
        """Move nodes towards equilibrium, using the last computed tangent.

        Args:
            load: Force on each node [N].
            part: Fraction of the change to equilibrium, 0 to 1.
        """
        self._launch(balance_forces, self.data, load, self.solve_data)
        self._solve()
        self._launch(move_nodes, part, load, self.data, self.solve_data)

    def respond(self, load: wp.array) -> None:
        """Compute the ``change`` that a load [N] alone would cause, without moving the nodes."""
        self._launch(take_load, load, self.solve_data)
        self._solve()

    def _solve(self) -> None:
        """Solve for the change that balances the residual, by conjugate gradients."""
        solve = self.solve_data
        solve.size.zero_()
        solve.curvature.zero_()
        self._launch(start_solve, self.data, solve)
        for iteration in range(self.iterations):
            self._launch(multiply, iteration, self.data, solve)
            self._launch(advance_solve, iteration, self.data, solve)
            if iteration + 1 < self.iterations:
                self._launch(turn_direction, iteration, solve)

    def _launch(self, kernel: wp.Kernel, *inputs: Any) -> None:
        wp.launch(kernel, dim=self.count, inputs=list(inputs), device=self.device)

    def snapshot(self) -> dict[str, NDArray]:
        """Positions and forces of the nodes, and their skinned positions and rotations."""
        names = ("position", "carried", "frame", "inner")
        return {name: getattr(self.data, name).numpy().copy() for name in names}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore the state returned by `snapshot`."""
        for name in ("position", "carried", "frame", "inner"):
            getattr(self.data, name).assign(state[name])
