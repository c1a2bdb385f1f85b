# SPDX-License-Identifier: GPL-3.0-or-later
"""The elasticity of flesh: stress, internal forces and tangent of tetrahedra on bones.

Elasticity is corotational (Müller and Gross, *Interactive Virtual Materials*, Graphics Interface
2004, doi 10.5555/1006058.1006087). Rotations are extracted as in Müller et al., *A Robust Method to
Extract the Rotational Part of Deformations*, Motion in Games 2016, doi 10.1145/2994258.2994269,
which also works for flat and inverted tetrahedra.
"""

import warp as wp

from ..core.vector_units import OPTIONS

wp.set_module_options(OPTIONS)

ROTATION_STEPS = 8
"""Largest number of steps to find a tetrahedron's rotation, starting from that of its bones."""
ROTATION_TOLERANCE = 1.0e-3
"""Iteration stops after a step of less than twice this angle [rad]; convergence is quadratic."""
STIFFENING_STRAIN = 0.3
"""Strain at which flesh is twice as stiff as at rest, because wavy fibers straighten. A few newtons
flatten a fingertip, which then hardly yields further."""


@wp.struct
class FleshData:
    """Flesh on the device."""

    lame: wp.vec2
    """First Lamé parameter and shear modulus [Pa]."""
    young_modulus: float
    """[Pa]"""
    max_step: float
    """Largest motion of a node in a solve [m]."""
    tetrahedron: wp.array[wp.vec4i]
    """Nodes of each tetrahedron."""
    gradient: wp.array2d[wp.vec3]
    """Gradients of shape functions at rest [1/m], by tetrahedron and corner."""
    volume: wp.array[float]
    """Volume of each tetrahedron inside the skin [m³]."""
    rest: wp.array[wp.vec3]
    """Nodes at rest [m]."""
    bone: wp.array[wp.vec4i]
    """Bones that carry each node."""
    weight: wp.array[wp.vec4]
    """Weights of these bones."""
    foundation: wp.array[float]
    """Stiffness of the elastic foundation between bones and nodes [N/m], by block."""
    skinning: wp.array[wp.mat44]
    """Each bone's map from rest to current world positions."""
    bone_frame: wp.array[wp.quat]
    """Rotation of each bone from rest."""
    position: wp.array[wp.vec3]
    """Nodes [m]."""
    carried: wp.array[wp.vec3]
    """Position of each node by skinning alone [m]."""
    frame: wp.array[wp.quat]
    """Rotation of each node with its bones."""
    inner: wp.array[wp.vec3]
    """Force of flesh and bone on each node [N]."""
    turned_gradient: wp.array2d[wp.vec3]
    """Gradients rotated with each tetrahedron [1/m]."""
    traction: wp.array2d[wp.vec3]
    """Stress before stiffening times each corner's rotated gradient [Pa/m]."""
    stiffening: wp.array[wp.vec2]
    """Factor by which strain stiffens each tetrahedron, and its derivative by energy [1/Pa]."""
    row: wp.array[int]
    """Index of each node's first block, which is its diagonal block."""
    column: wp.array[int]
    """Node of each block."""
    share: wp.array[int]
    """Index of the first part of each block."""
    part: wp.array[wp.vec3i]
    """Tetrahedron that contributes to a block, and its two corners."""
    block: wp.array[wp.mat33]
    """Tangent stiffness [N/m]."""
    inverse: wp.array[wp.mat33]
    """Inverse of each node's diagonal block [m/N]."""
    touching: wp.array2d[wp.vec2i]
    """Tetrahedra around each node and its corner in them, padded with -1."""


@wp.kernel(enable_backward=False)
def carry_nodes(flesh: FleshData) -> None:
    """Move nodes with the bones; their deflection rotates with the bones."""
    i = wp.tid()
    bone = flesh.bone[i]
    weight = flesh.weight[i]
    x = flesh.rest[i]
    carried = wp.vec3()
    blend = wp.quat(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if weight[k] > 0.0:
            carried += wp.transform_point(flesh.skinning[bone[k]], x) * weight[k]
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
    """Rotation of a deformation gradient, by iteration from a starting guess."""
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
    # Twice the energy density over Young's modulus: the squared strain under uniaxial stress.
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
        force += (flesh.carried[j] - flesh.position[j]) * flesh.foundation[at]
    for k in range(flesh.touching.shape[1]):
        corner = flesh.touching[i, k]
        if corner[0] >= 0:
            stiffening = flesh.stiffening[corner[0]]
            force -= flesh.traction[corner[0], corner[1]] * (
                flesh.volume[corner[0]] * stiffening[0]
            )
    flesh.inner[i] = force


@wp.kernel(enable_backward=False)
def assemble_tangent(flesh: FleshData) -> None:
    """Assemble the blocks of each node's row."""
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
        # Rigid translation causes no strain, so the rows of the stiffness sum to zero.
        own -= block
        flesh.block[at] = block + wp.identity(n=3, dtype=float) * flesh.foundation[at]
    own += wp.identity(n=3, dtype=float) * flesh.foundation[begin]
    flesh.block[begin] = own
    flesh.inverse[i] = wp.inverse(own)
