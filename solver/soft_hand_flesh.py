# SPDX-License-Identifier: GPL-3.0-or-later
"""Elastic flesh on bones: corotated linear tetrahedra in equilibrium, solved for implicitly.

Each tetrahedron is elastic about its own rotation (Müller and Gross, *Interactive Virtual
Materials*, Graphics Interface 2004, doi 10.5555/1006058.1006087), which Müller et al., *A Robust
Method to Extract the Rotational Part of Deformations*, Motion in Games 2016,
doi 10.1145/2994258.2994269, find even where a tetrahedron is flat or turned inside out. Flesh is
light and heavily damped: it has no inertia here, and is where its forces balance. A solve is one
Newton step by conjugate gradients.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .hand_rig import HandRig
from .soft_hand_rest import BEDDING_LENGTH, FleshRest
from .vector_units import OPTIONS

wp.set_module_options(OPTIONS)

ROTATION_STEPS = 8
"""Steps towards a tetrahedron's rotation, from that of the bones around it, at most."""
ROTATION_TOLERANCE = 1.0e-3
"""It is found when a step turns it by less than twice this [rad]; the next would by its square."""

STIFFENING_STRAIN = 0.3
"""At this strain flesh is twice as stiff as at none: fibres that lay wavy pull straight. By a few
newtons a fingertip goes flat, and then hardly gives any more."""

LONGEST_STEP = 0.01
"""What a node moves in a solve at most, over the size of the hand."""
RELAXATION_TIME = 0.008
"""Flesh follows what loads it with this delay [s]."""


def yielded_part(time_step: float) -> float:
    """How far flesh gives way in a time [s], of what forces ask for."""
    return time_step / (time_step + RELAXATION_TIME)


@wp.struct
class FleshData:
    """Flesh on the device."""

    lame: wp.vec2
    """First Lamé parameter and shear modulus [Pa]."""
    young_modulus: float
    """[Pa]"""
    longest_step: float
    """What a node moves in a solve at most [m]."""
    tetrahedron: wp.array[wp.vec4i]
    gradient: wp.array2d[wp.vec3]
    """Of shape functions at rest [1/m]; by tetrahedron and corner."""
    volume: wp.array[float]
    """Of each tetrahedron inside the skin [m³]."""
    rest: wp.array[wp.vec3]
    """Nodes at rest [m]."""
    bone: wp.array[wp.vec4i]
    """Bones that carry each node."""
    weight: wp.array[wp.vec4]
    bedding: wp.array[float]
    """How stiffly bone holds nodes [N/m], by block."""
    turn: wp.array[wp.mat44]
    """World at present from world at rest, by bone."""
    bone_frame: wp.array[wp.quat]
    """How each bone is turned."""
    position: wp.array[wp.vec3]
    """Nodes [m]."""
    carried: wp.array[wp.vec3]
    """Where bones alone would carry each node [m]."""
    frame: wp.array[wp.quat]
    """How bones turn each node."""
    inner: wp.array[wp.vec3]
    """Force of flesh and bone on each node [N]."""
    turned_gradient: wp.array2d[wp.vec3]
    """Gradients turned by each tetrahedron's rotation [1/m]."""
    traction: wp.array2d[wp.vec3]
    """Stress before stiffening on each corner's turned gradient [Pa/m]."""
    stiffening: wp.array[wp.vec2]
    """By how much strain stiffens each tetrahedron, and how that grows with its energy [1/Pa]."""
    row: wp.array[int]
    """Where each node's blocks begin; the first is its own."""
    column: wp.array[int]
    """Node of each block."""
    share: wp.array[int]
    """Where the parts of each block begin."""
    part: wp.array[wp.vec3i]
    """Tetrahedron that a block gets a part from, and the two corners there."""
    block: wp.array[wp.mat33]
    """Tangent stiffness [N/m]."""
    inverse: wp.array[wp.mat33]
    """Of each node's own block [m/N]."""
    touching: wp.array2d[wp.vec2i]
    """Tetrahedra around each node, and its corner there; -1 behind the last."""


@wp.struct
class FleshSolve:
    """What the passes of conjugate gradients share."""

    residual: wp.array[wp.vec3]
    """Force not yet in balance [N]."""
    z: wp.array[wp.vec3]
    direction: wp.array[wp.vec3]
    product: wp.array[wp.vec3]
    change: wp.array[wp.vec3]
    """What the solve moves nodes by [m]."""
    size: wp.array[wp.float64]
    """Preconditioned square of the residual, by iteration [N m]."""
    curvature: wp.array[wp.float64]
    """Energy of the direction, by iteration [N m]."""


@wp.kernel(enable_backward=False)
def carry_nodes(flesh: FleshData) -> None:
    """Let bones carry nodes, which keep their place in the frame that turns with the bones."""
    i = wp.tid()
    bone = flesh.bone[i]
    weight = flesh.weight[i]
    x = flesh.rest[i]
    carried = wp.vec3()
    blend = wp.quat(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if weight[k] > 0.0:
            carried += wp.transform_point(flesh.turn[bone[k]], x) * weight[k]
            q = flesh.bone_frame[bone[k]]
            side = wp.where(wp.dot(q, blend) < 0.0, -1.0, 1.0)
            blend = blend + q * (side * weight[k])
    frame = wp.normalize(blend)
    turned = frame * wp.quat_inverse(flesh.frame[i])
    flesh.position[i] = carried + wp.quat_rotate(turned, flesh.position[i] - flesh.carried[i])
    flesh.inner[i] = wp.quat_rotate(turned, flesh.inner[i])
    flesh.carried[i] = carried
    flesh.frame[i] = frame


@wp.func
def rotation_of(deformation: wp.mat33, start: wp.quat) -> wp.mat33:
    """Rotation of a deformation, from a guess nearby."""
    q = start
    r = wp.quat_to_matrix(q)
    step = int(0)
    while step < ROTATION_STEPS:
        step += 1
        product = deformation * wp.transpose(r)
        half = wp.vec3(
            product[2, 1] - product[1, 2],
            product[0, 2] - product[2, 0],
            product[1, 0] - product[0, 1],
        ) * (0.5 / (wp.abs(wp.trace(product)) + 1.0e-9))
        q = wp.normalize(wp.quat(half[0], half[1], half[2], 1.0) * q)
        r = wp.quat_to_matrix(q)
        if wp.length_sq(half) < ROTATION_TOLERANCE * ROTATION_TOLERANCE:
            step = ROTATION_STEPS
    return r


@wp.kernel(enable_backward=False)
def measure_stress(flesh: FleshData) -> None:
    """Find each tetrahedron's rotation and stress."""
    t = wp.tid()
    corner = flesh.tetrahedron[t]
    origin = flesh.position[corner[0]]
    deformation = wp.mat33()
    start = flesh.frame[corner[0]]
    first = start
    for k in range(1, 4):
        deformation += wp.outer(flesh.position[corner[k]] - origin, flesh.gradient[t, k])
        q = flesh.frame[corner[k]]
        start = start + q * wp.where(wp.dot(q, first) < 0.0, -1.0, 1.0)
    r = rotation_of(deformation, wp.normalize(start))
    for k in range(4):
        flesh.turned_gradient[t, k] = r * flesh.gradient[t, k]
    stretch = wp.transpose(r) * deformation
    strain = (stretch + wp.transpose(stretch)) * 0.5 - wp.identity(n=3, dtype=float)
    lame = flesh.lame
    stress = strain * (2.0 * lame[1]) + wp.identity(n=3, dtype=float) * (lame[0] * wp.trace(strain))
    # Twice the energy over Young's modulus: the square of the strain, where stress is uniaxial.
    square = wp.ddot(stress, strain) / flesh.young_modulus
    grown = square / (STIFFENING_STRAIN * STIFFENING_STRAIN)
    flesh.stiffening[t] = wp.vec2(
        1.0 + grown * grown,
        4.0 * grown / (STIFFENING_STRAIN * STIFFENING_STRAIN * flesh.young_modulus),
    )
    turned_stress = r * stress * wp.transpose(r)
    for k in range(4):
        flesh.traction[t, k] = turned_stress * flesh.turned_gradient[t, k]


@wp.kernel(enable_backward=False)
def sum_inner_forces(flesh: FleshData) -> None:
    """Sum the forces of flesh and bone on each node."""
    i = wp.tid()
    force = wp.vec3()
    for at in range(flesh.row[i], flesh.row[i + 1]):
        j = flesh.column[at]
        force += (flesh.carried[j] - flesh.position[j]) * flesh.bedding[at]
    for k in range(flesh.touching.shape[1]):
        corner = flesh.touching[i, k]
        if corner[0] >= 0:
            stiffening = flesh.stiffening[corner[0]]
            force -= flesh.traction[corner[0], corner[1]] * (
                flesh.volume[corner[0]] * stiffening[0]
            )
    flesh.inner[i] = force


@wp.kernel(enable_backward=False)
def balance_forces(flesh: FleshData, load: wp.array[wp.vec3], solve: FleshSolve) -> None:
    """Find what is out of balance."""
    i = wp.tid()
    solve.residual[i] = load[i] + flesh.inner[i]


@wp.kernel(enable_backward=False)
def take_load(load: wp.array[wp.vec3], solve: FleshSolve) -> None:
    """Let the load alone be what is out of balance."""
    i = wp.tid()
    solve.residual[i] = load[i]


@wp.kernel(enable_backward=False)
def assemble_tangent(flesh: FleshData) -> None:
    """Sum up the blocks of each node's row."""
    i = wp.tid()
    own = wp.mat33()
    lame = flesh.lame
    begin = flesh.row[i]
    for at in range(begin + 1, flesh.row[i + 1]):
        block = wp.mat33()
        for k in range(flesh.share[at], flesh.share[at + 1]):
            part = flesh.part[k]
            a = flesh.turned_gradient[part[0], part[1]]
            b = flesh.turned_gradient[part[0], part[2]]
            stiffening = flesh.stiffening[part[0]]
            volume = flesh.volume[part[0]] * stiffening[0]
            block += wp.outer(a, b) * (volume * lame[0]) + wp.outer(b, a) * (volume * lame[1])
            block += wp.identity(n=3, dtype=float) * (volume * lame[1] * wp.dot(a, b))
            block += wp.outer(
                flesh.traction[part[0], part[1]], flesh.traction[part[0], part[2]]
            ) * (flesh.volume[part[0]] * stiffening[1])
        # Flesh that moves as a whole is not strained: the rows of its stiffness add up to zero.
        own -= block
        flesh.block[at] = block + wp.identity(n=3, dtype=float) * flesh.bedding[at]
    own += wp.identity(n=3, dtype=float) * flesh.bedding[begin]
    flesh.block[begin] = own
    flesh.inverse[i] = wp.inverse(own)


@wp.kernel(enable_backward=False)
def start_solve(flesh: FleshData, solve: FleshSolve) -> None:
    """Begin with no change."""
    i = wp.tid()
    z = flesh.inverse[i] * solve.residual[i]
    solve.z[i] = z
    solve.direction[i] = z
    solve.change[i] = wp.vec3()
    wp.atomic_add(solve.size, 0, wp.float64(wp.dot(z, solve.residual[i])))


@wp.kernel(enable_backward=False)
def multiply(iteration: int, flesh: FleshData, solve: FleshSolve) -> None:
    """Multiply the tangent with the direction."""
    i = wp.tid()
    product = wp.vec3()
    for at in range(flesh.row[i], flesh.row[i + 1]):
        product += flesh.block[at] * solve.direction[flesh.column[at]]
    solve.product[i] = product
    wp.atomic_add(solve.curvature, iteration, wp.float64(wp.dot(solve.direction[i], product)))


@wp.kernel(enable_backward=False)
def advance_solve(iteration: int, flesh: FleshData, solve: FleshSolve) -> None:
    """Go along the direction as far as it helps."""
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
    """Take up the next direction."""
    i = wp.tid()
    keep = float(0.0)
    if solve.size[iteration] > wp.float64(0.0):
        keep = float(solve.size[iteration + 1] / solve.size[iteration])
    solve.direction[i] = solve.z[i] + solve.direction[i] * keep


@wp.kernel(enable_backward=False)
def move_nodes(part: float, load: wp.array[wp.vec3], flesh: FleshData, solve: FleshSolve) -> None:
    """Move nodes by a part of what the solve found; one not finite stays with its bones.

    Where a load is so sudden that the tangent says nothing about it, nodes must not fly off.
    The inner forces change by what the solve has taken off the residual.
    """
    i = wp.tid()
    inner = flesh.inner[i]
    inner -= (load[i] + inner - solve.residual[i]) * part
    flesh.inner[i] = wp.where(wp.isfinite(inner), inner, wp.vec3())
    change = solve.change[i] * part
    change = change * wp.min(1.0, flesh.longest_step / wp.max(wp.length(change), 1.0e-12))
    moved = flesh.position[i] + change
    flesh.position[i] = wp.where(wp.isfinite(moved), moved, flesh.carried[i])


class Flesh:
    """The flesh of one hand on the device.

    *Limitations*: strain is linear about the rotation, so flesh pressed to less than half its
    thickness is softer than real flesh. Linear tetrahedra are too stiff in bending and when
    nearly incompressible. Skin is not stiffer than flesh, and does not meet itself.

    Args:
        rig: The hand.
        rest: What `rest_of` measured of it.
        young_modulus: [Pa]
        poisson_ratio: Below 0.5.
        iterations: Of conjugate gradients in a solve.
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
        row, column, share, part = _pattern(tetrahedra, self.count)
        data = FleshData()
        data.lame = wp.vec2(first, shear)
        data.young_modulus = young_modulus
        data.longest_step = LONGEST_STEP * float(np.linalg.norm(np.ptp(rig.nodes, axis=0)))

        def put(values: NDArray, dtype: Any) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        def room(count: int, dtype: Any) -> wp.array:
            return wp.zeros(count, dtype=dtype, device=device)

        data.tetrahedron = put(tetrahedra, wp.vec4i)
        data.gradient = put(rest.gradients, wp.vec3)
        data.volume = put(rest.volumes, float)
        data.rest = put(rig.nodes, wp.vec3)
        data.bone = put(rig.node_bones, wp.vec4i)
        data.weight = put(rig.node_weights, wp.vec4)
        bedding = _by_block(rest.bone_shares, tetrahedra, row, column, share, part)
        data.bedding = put(young_modulus / BEDDING_LENGTH**2 * bedding, float)
        data.turn = put(np.tile(np.eye(4), (len(rig.bone_names), 1, 1)), wp.mat44)
        data.bone_frame = put(np.tile((0.0, 0.0, 0.0, 1.0), (len(rig.bone_names), 1)), wp.quat)
        data.position = put(rig.nodes, wp.vec3)
        data.carried = put(rig.nodes, wp.vec3)
        data.frame = put(np.tile((0.0, 0.0, 0.0, 1.0), (self.count, 1)), wp.quat)
        data.inner = room(self.count, wp.vec3)
        data.turned_gradient = wp.zeros_like(data.gradient)
        data.traction = wp.zeros_like(data.gradient)
        data.stiffening = room(len(tetrahedra), wp.vec2)
        data.row, data.column = put(row, int), put(column, int)
        data.share, data.part = put(share, int), put(part, wp.vec3i)
        data.block = room(len(column), wp.mat33)
        data.inverse = room(self.count, wp.mat33)
        data.touching = put(_incidences(tetrahedra, self.count), wp.vec2i)
        self.data = data
        solve = FleshSolve()
        for name in ("residual", "z", "direction", "product", "change"):
            setattr(solve, name, room(self.count, wp.vec3))
        solve.size = room(iterations + 1, wp.float64)
        solve.curvature = room(iterations, wp.float64)
        self.solve_data = solve

    def carry(self) -> None:
        """Let nodes follow the bones, which stand where ``turn`` says."""
        self._launch(carry_nodes, self.data)

    def stretch(self) -> None:
        """Find stress and inner forces where nodes are."""
        tetrahedra = len(self.data.volume)
        wp.launch(measure_stress, dim=tetrahedra, inputs=[self.data], device=self.device)
        self._launch(sum_inner_forces, self.data)

    def stiffen(self) -> None:
        """Find the tangent to that stress."""
        self._launch(assemble_tangent, self.data)

    def relax(self, load: wp.array, part: float) -> None:
        """Move nodes towards where forces balance, by the tangent found last.

        Args:
            load: Force on each node [N].
            part: How far, of the whole way.
        """
        self._launch(balance_forces, self.data, load, self.solve_data)
        self._solve()
        self._launch(move_nodes, part, load, self.data, self.solve_data)

    def respond(self, load: wp.array) -> None:
        """Find the ``change`` that a load [N] alone would make; the nodes stay."""
        self._launch(take_load, load, self.solve_data)
        self._solve()

    def _solve(self) -> None:
        """Solve for the change that balances the residual."""
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
        """Where nodes are, and where bones carry them."""
        names = ("position", "carried", "frame", "inner")
        return {name: getattr(self.data, name).numpy().copy() for name in names}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take up the state that `snapshot` gave."""
        for name in ("position", "carried", "frame", "inner"):
            getattr(self.data, name).assign(state[name])


def _pattern(
    tetrahedra: NDArray[np.int32], node_count: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Which nodes share tetrahedra, by rows.

    Returns:
        Where rows begin, shape [N + 1]; the column of each block, a node's own first; where the
        parts of blocks begin; and for each part its tetrahedron and two corners.
    """
    count = len(tetrahedra)
    first, second = (corner.ravel() for corner in np.indices((4, 4)))
    off = first != second
    first, second = first[off], second[off]
    rows, columns = tetrahedra[:, first].ravel(), tetrahedra[:, second].ravel()
    parts = np.column_stack(
        [np.repeat(np.arange(count), len(first)), np.tile(first, count), np.tile(second, count)]
    )
    own = np.arange(node_count)
    key = np.concatenate([rows.astype(np.int64) * (node_count + 1) + columns + 1])
    order = np.argsort(key, kind="stable")
    keys, sizes = np.unique(key, return_counts=True)
    # A node's own block stands before the others, and is the sum of them: it has no parts.
    keys = np.concatenate([own.astype(np.int64) * (node_count + 1), keys])
    sizes = np.concatenate([np.zeros(node_count, int), sizes])
    place = np.argsort(keys, kind="stable")
    keys, sizes = keys[place], sizes[place]
    block_row = keys // (node_count + 1)
    column = keys % (node_count + 1) - 1
    column = np.where(column < 0, block_row, column)
    row = np.searchsorted(block_row, np.arange(node_count + 1))
    share = np.concatenate([[0], np.cumsum(sizes)])
    return (
        row.astype(np.int32),
        column.astype(np.int32),
        share.astype(np.int32),
        parts[order].astype(np.int32),
    )


def _by_block(
    matrices: NDArray[np.float64],
    tetrahedra: NDArray[np.int32],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    share: NDArray[np.int32],
    part: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Sum matrices of tetrahedra, shape [T, 4, 4], into the blocks of `_pattern`."""
    values = np.zeros(len(column))
    at = np.repeat(np.arange(len(column)), np.diff(share))
    np.add.at(values, at, matrices[part[:, 0], part[:, 1], part[:, 2]])
    own = np.einsum("tkk->tk", matrices)
    np.add.at(values, row[tetrahedra.ravel()], own.ravel())
    return values


def _incidences(tetrahedra: NDArray[np.int32], node_count: int) -> NDArray[np.int32]:
    """Tetrahedra around each node, and its corner there, shape [N, K, 2], padded with -1."""
    nodes = tetrahedra.ravel()
    order = np.argsort(nodes, kind="stable")
    counts = np.bincount(nodes, minlength=node_count)
    begin = np.concatenate([[0], np.cumsum(counts)[:-1]])
    column = np.arange(len(nodes)) - begin[nodes[order]]
    table = np.full((node_count, int(counts.max(initial=1)), 2), -1, np.int32)
    table[nodes[order], column, 0] = order // 4
    table[nodes[order], column, 1] = order % 4
    return table
