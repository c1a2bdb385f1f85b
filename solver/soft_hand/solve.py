# SPDX-License-Identifier: GPL-3.0-or-later
"""Conjugate gradients for the equilibrium of flesh, with a block-Jacobi preconditioner."""

import warp as wp

from ..core.vector_units import OPTIONS
from .elasticity import FleshData

wp.set_module_options(OPTIONS)


@wp.struct
class FleshSolve:
    """Vectors and scalars of conjugate gradients."""

    residual: wp.array[wp.vec3]
    """Unbalanced force [N]."""
    z: wp.array[wp.vec3]
    """Preconditioned residual [m]."""
    direction: wp.array[wp.vec3]
    """Search direction [m]."""
    product: wp.array[wp.vec3]
    """Tangent times search direction [N]."""
    change: wp.array[wp.vec3]
    """Displacement of nodes by the solve [m]."""
    size: wp.array[wp.float64]
    """Product of residual and preconditioned residual, by iteration [N m]."""
    curvature: wp.array[wp.float64]
    """Product of search direction and tangent times search direction, by iteration [N m]."""


@wp.kernel(enable_backward=False)
def balance_forces(flesh: FleshData, load: wp.array[wp.vec3], solve: FleshSolve) -> None:
    """Set the residual to the sum of load and internal forces."""
    i = wp.tid()
    solve.residual[i] = load[i] + flesh.inner[i]


@wp.kernel(enable_backward=False)
def take_load(load: wp.array[wp.vec3], solve: FleshSolve) -> None:
    """Set the residual to the load alone."""
    i = wp.tid()
    solve.residual[i] = load[i]


@wp.kernel(enable_backward=False)
def start_solve(flesh: FleshData, solve: FleshSolve) -> None:
    """Start from zero change."""
    i = wp.tid()
    z = flesh.inverse[i] * solve.residual[i]
    solve.z[i] = z
    solve.direction[i] = z
    solve.change[i] = wp.vec3()
    wp.atomic_add(solve.size, 0, wp.float64(wp.dot(z, solve.residual[i])))


@wp.kernel(enable_backward=False)
def multiply(iteration: int, flesh: FleshData, solve: FleshSolve) -> None:
    """Multiply the tangent by the search direction."""
    i = wp.tid()
    product = wp.vec3()
    for at in range(flesh.row[i], flesh.row[i + 1]):
        product += flesh.block[at] * solve.direction[flesh.column[at]]
    solve.product[i] = product
    wp.atomic_add(solve.curvature, iteration, wp.float64(wp.dot(solve.direction[i], product)))


@wp.kernel(enable_backward=False)
def advance_solve(iteration: int, flesh: FleshData, solve: FleshSolve) -> None:
    """Step along the search direction to the minimum."""
    i = wp.tid()
    step = float(0.0)
    if solve.curvature[iteration] > wp.float64(0.0):
        step = float(solve.size[iteration] / solve.curvature[iteration])
    solve.change[i] = solve.change[i] + solve.direction[i] * step
    residual = solve.residual[i] - solve.product[i] * step
    z = flesh.inverse[i] * residual
    solve.residual[i] = residual
    solve.z[i] = z
    wp.atomic_add(solve.size, iteration + 1, wp.float64(wp.dot(z, residual)))


@wp.kernel(enable_backward=False)
def turn_direction(iteration: int, solve: FleshSolve) -> None:
    """Compute the next search direction."""
    i = wp.tid()
    keep = float(0.0)
    if solve.size[iteration] > wp.float64(0.0):
        keep = float(solve.size[iteration + 1] / solve.size[iteration])
    solve.direction[i] = solve.z[i] + solve.direction[i] * keep


@wp.kernel(enable_backward=False)
def move_nodes(part: float, load: wp.array[wp.vec3], flesh: FleshData, solve: FleshSolve) -> None:
    """Move nodes by a part of the solution; nodes that are not finite are reset to their bones.

    Steps are limited, because the tangent is inaccurate for large sudden loads. The internal forces
    change by as much as the solve reduced the residual.
    """
    i = wp.tid()
    inner = flesh.inner[i]
    inner -= (load[i] + inner - solve.residual[i]) * part
    flesh.inner[i] = wp.where(wp.isfinite(inner), inner, wp.vec3())
    change = solve.change[i] * part
    change = change * wp.min(1.0, flesh.max_step / wp.max(wp.length(change), 1.0e-12))
    moved = flesh.position[i] + change
    flesh.position[i] = wp.where(wp.isfinite(moved), moved, flesh.carried[i])
