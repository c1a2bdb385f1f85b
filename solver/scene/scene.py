# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in a simulation: clay, planes, moving closed meshes and hands, for a `Solver`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.closed_mesh import closed_mesh
from ..geometry.fill import fill_mesh
from ..hand.rig import HandRig
from .hand import POISSON_RATIO, YOUNG_MODULUS, Hand
from .material import Material

DEFAULT_COLOR = (0.72, 0.36, 0.22, 1.0)
"""Terracotta, linear RGBA."""


@dataclass(frozen=True)
class ClayBody:
    """A piece of clay as it was added: particles ``start`` to ``start + count`` of the solver."""

    start: int
    """Index of its first particle."""
    count: int
    """Number of its particles."""
    material: Material
    """What it is made of."""


@dataclass(frozen=True)
class Plane:
    """An endless, unmoving plane; clay stays on the side its normal points to."""

    point: NDArray[np.float64]
    """A point on it [m], shape [3]."""
    normal: NDArray[np.float64]
    """Unit normal, shape [3]."""
    friction: float
    """Coulomb friction coefficient."""
    adhesion: float = 0.0
    """Stress at which clay that sticks to it comes off [Pa]."""


class MeshCollider:
    """A closed mesh that clay cannot enter. It may move, turn, scale and change its shape.

    Made by `Scene.add_mesh`. What is set between two steps is reached at the end of the next
    step, evenly in between.
    """

    def __init__(
        self,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        friction: float,
        adhesion: float,
    ) -> None:
        self.faces = faces
        self.friction = friction
        self.adhesion = adhesion
        self._vertices = vertices
        self._pose = np.eye(4)
        self._enabled = True
        self.shape_version = 0

    @property
    def vertices(self) -> NDArray[np.float64]:
        """Vertices in the collider's own coordinates [m], shape [V, 3]."""
        return self._vertices

    @property
    def pose(self) -> NDArray[np.float64]:
        """World from own coordinates, shape [4, 4]."""
        return self._pose

    @property
    def enabled(self) -> bool:
        """Whether the clay meets it."""
        return self._enabled

    def set_enabled(self, enabled: bool) -> None:
        """Say whether the clay meets it from the next step on.

        A collider that is not enabled may be moved anywhere, through clay, too: it costs nothing
        and meets nothing. When it is enabled again it is at its pose at once, without sweeping the
        way there, and clay inside it is moved out gently.
        """
        self._enabled = bool(enabled)

    def set_pose(self, pose: ArrayLike) -> None:
        """Move to a pose by the end of the next step.

        Args:
            pose: World from own coordinates, shape [4, 4]; rotation, translation [m], and any
                scale or mirroring.

        Raises:
            ValueError: The matrix is not finite, not 4×4, not affine, or flattens the mesh. The
                collider keeps its last good pose.
        """
        matrix = np.asarray(pose, np.float64)
        if matrix.shape != (4, 4):
            raise ValueError(f"A pose is a 4x4 matrix; this one has shape {matrix.shape}.")
        if not np.isfinite(matrix).all():
            raise ValueError("The pose has values that are not finite; the last good one is kept.")
        if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0)):
            raise ValueError("The pose's last row must be 0 0 0 1.")
        scales = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        if scales[-1] < 1e-6 * max(scales[0], 1e-30):
            raise ValueError("The pose scales the mesh flat; give every axis a scale above zero.")
        if not np.array_equal(matrix[:3, :3], self._pose[:3, :3]):
            self.shape_version += 1
        self._pose = matrix.copy()

    def set_vertices(self, vertices: ArrayLike) -> None:
        """Deform to new vertices by the end of the next step.

        Args:
            vertices: Vertices in own coordinates [m], shape [V, 3], in the order given to
                `Scene.add_mesh`.

        Raises:
            ValueError: Wrong shape or values that are not finite. The last good ones stay.
        """
        points = np.asarray(vertices, np.float64)
        if points.shape != self._vertices.shape:
            raise ValueError(
                f"The collider has {len(self._vertices)} vertices; got an array of shape "
                f"{points.shape}. The number of vertices must not change."
            )
        if not np.isfinite(points).all():
            raise ValueError("Vertices are not finite; the last good ones are kept.")
        self._vertices = points.copy()
        self.shape_version += 1


class Scene:
    """Clay and what it meets. SI units, Z up, right-handed.

    Example::

        scene = Scene(spacing=0.005)
        scene.add_clay_mesh(vertices, faces, Material.preset("plasticine"))
        scene.add_plane((0, 0, 0), (0, 0, 1), friction=0.5)
        tool = scene.add_mesh(tool_vertices, tool_faces)
        solver = Solver(scene)
        solver.step(1 / 60)

    Args:
        spacing: Distance of neighboring particles at rest [m].
        gravity: Acceleration of free fall [m/s²], shape [3].

    Raises:
        ValueError: A value is not finite, or the spacing is not positive.
    """

    def __init__(
        self, spacing: float = 0.005, gravity: Sequence[float] = (0.0, 0.0, -9.81)
    ) -> None:
        if not (np.isfinite(spacing) and spacing > 0):
            raise ValueError(f"The particle spacing is {spacing!r} m; it must be above 0.")
        values = _finite_vector(gravity, "gravity")
        self.spacing = float(spacing)
        self.gravity = (float(values[0]), float(values[1]), float(values[2]))
        self.bodies: list[ClayBody] = []
        self.planes: list[Plane] = []
        self.meshes: list[MeshCollider] = []
        self.hands: list[Hand] = []
        self._points: list[NDArray[np.float32]] = []
        self._colors: list[NDArray[np.float32]] = []
        self._velocities: list[NDArray[np.float32]] = []

    @property
    def particle_count(self) -> int:
        """Number of clay particles so far."""
        return sum(body.count for body in self.bodies)

    def add_clay(
        self,
        points: ArrayLike,
        material: Material,
        *,
        colors: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
    ) -> ClayBody:
        """Add particles; those that lie close together stick from the start.

        Args:
            points: Positions [m], shape [N, 3], about one spacing apart.
            material: What they are made of.
            colors: Linear RGBA in 0..1, shape [N, 4] or [4]; terracotta where not given.
            velocities: Initial velocities [m/s], shape [N, 3] or [3]; at rest where not given.

        Raises:
            ValueError: Wrong shape, or values that are not finite; the message says how many.
        """
        positions = np.asarray(points, np.float32)
        if positions.size == 0:
            positions = positions.reshape(0, 3)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise ValueError(f"Clay points have shape {positions.shape}; expected (N, 3).")
        count = len(positions)
        bad = int((~np.isfinite(positions).all(1)).sum())
        if bad:
            raise ValueError(f"{bad} of {count} clay points are not finite; leave them out.")
        body = ClayBody(self.particle_count, count, material)
        chosen = DEFAULT_COLOR if colors is None else colors
        self._colors.append(_rows(chosen, count, 4, "colors"))
        self._velocities.append(
            _rows((0.0, 0.0, 0.0) if velocities is None else velocities, count, 3, "velocities")
        )
        self._points.append(positions)
        self.bodies.append(body)
        return body

    def add_clay_mesh(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        material: Material,
        *,
        color: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
    ) -> ClayBody:
        """Fill a closed mesh with clay: round(volume / spacing³) particles.

        Args:
            vertices: Corner positions [m], shape [V, 3].
            faces: Triangles, shape [F, 3].
            material: What it is made of.
            color: Linear RGBA in 0..1, shape [4].
            velocity: Initial velocity [m/s], shape [3].

        Raises:
            MeshError: The mesh is open (the message names the number of holes), encloses no
                volume, is too small for the spacing, or has coordinates that are not finite.
        """
        points = fill_mesh(vertices, faces, self.spacing)
        return self.add_clay(points, material, colors=color, velocities=velocity)

    def add_plane(
        self,
        point: Sequence[float] = (0.0, 0.0, 0.0),
        normal: Sequence[float] = (0.0, 0.0, 1.0),
        *,
        friction: float = 0.5,
        adhesion: float = 0.0,
    ) -> Plane:
        """Add an infinite plane, such as a table.

        Args:
            point: A point on it [m], shape [3].
            normal: Direction of its free side, shape [3], of any length.
            friction: Coulomb friction coefficient.
            adhesion: Stress at which clay that has touched it comes off [Pa]; the model "paper"
                knows none.

        Raises:
            ValueError: A value is not finite, the normal is zero, or friction or adhesion is
                negative.
        """
        direction = _finite_vector(normal, "normal")
        length = float(np.linalg.norm(direction))
        if length == 0.0:
            raise ValueError("The plane's normal is zero; give it a direction.")
        plane = Plane(
            _finite_vector(point, "point"),
            direction / length,
            _friction(friction),
            _adhesion(adhesion),
        )
        self.planes.append(plane)
        return plane

    def add_mesh(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        friction: float = 0.5,
        adhesion: float = 0.0,
    ) -> MeshCollider:
        """Add a closed mesh that clay cannot enter; see `MeshCollider` for how it moves.

        Args:
            vertices: Corner positions in its own coordinates [m], shape [V, 3].
            faces: Triangles, shape [F, 3].
            friction: Coulomb friction coefficient.
            adhesion: Stress at which clay that has touched it comes off [Pa]; the model "paper"
                knows none.

        Raises:
            MeshError: The mesh is open, flat or has coordinates that are not finite.
            ValueError: The friction or the adhesion is negative or not finite.
        """
        points = np.asarray(vertices, np.float64)
        triangles = np.asarray(faces, np.int32)
        # Its vertices stay as they are given, so that all of them can be moved.
        closed = closed_mesh(points, triangles, name="The collider")
        triangles = triangles[closed.sources]
        triangles[closed.turned] = triangles[closed.turned][:, ::-1]
        collider = MeshCollider(
            points.copy(),
            np.ascontiguousarray(triangles),
            _friction(friction),
            _adhesion(adhesion),
        )
        self.meshes.append(collider)
        return collider

    def add_hand(
        self,
        rig: HandRig,
        *,
        friction: float = 0.5,
        young_modulus: float = YOUNG_MODULUS,
        poisson_ratio: float = POISSON_RATIO,
        hold_stiffness: float | None = None,
    ) -> Hand:
        """Add a hand; see `Hand` for how it moves.

        Args:
            rig: The hand as it was bound.
            friction: Coulomb friction coefficient.
            young_modulus: Of its flesh [Pa].
            poisson_ratio: Of its flesh, 0 to below 0.49.
            hold_stiffness: How stiffly it holds its pose against the clay: force on a fingertip
                over how far that gives way [N/m]. Where not given, bones are exactly where they
                are set to be, whatever the clay does.

        Raises:
            ValueError: A value is not finite or out of its range.
        """
        if not (np.isfinite(young_modulus) and young_modulus > 0):
            raise ValueError(
                f"The flesh's Young's modulus is {young_modulus!r}; it must be above 0."
            )
        if not 0.0 <= poisson_ratio < 0.49:
            raise ValueError(
                f"The flesh's Poisson's ratio is {poisson_ratio!r}; it must lie in 0 to below 0.49."
            )
        if hold_stiffness is not None and not (np.isfinite(hold_stiffness) and hold_stiffness > 0):
            raise ValueError(
                f"The hold stiffness is {hold_stiffness!r} N/m; it must be above 0, or None."
            )
        hand = Hand(
            rig,
            friction=_friction(friction),
            young_modulus=float(young_modulus),
            poisson_ratio=float(poisson_ratio),
            hold_stiffness=hold_stiffness,
        )
        self.hands.append(hand)
        return hand

    def initial_positions(self) -> NDArray[np.float32]:
        """Particle positions as added [m], shape [N, 3]."""
        return np.concatenate([np.zeros((0, 3), np.float32), *self._points])

    def initial_velocities(self) -> NDArray[np.float32]:
        """Particle velocities as added [m/s], shape [N, 3]."""
        return np.concatenate([np.zeros((0, 3), np.float32), *self._velocities])

    def colors(self) -> NDArray[np.float32]:
        """Particle colors, linear RGBA in 0..1, shape [N, 4]."""
        return np.concatenate([np.zeros((0, 4), np.float32), *self._colors])

    def materials(self) -> tuple[list[Material], NDArray[np.int32]]:
        """The different materials, and each particle's index among them, shape [N]."""
        distinct: list[Material] = []
        indices = [np.zeros(0, np.int32)]
        for body in self.bodies:
            if body.material not in distinct:
                distinct.append(body.material)
            indices.append(np.full(body.count, distinct.index(body.material), np.int32))
        return distinct, np.concatenate(indices)


def _finite_vector(value: Sequence[float] | ArrayLike, name: str) -> NDArray[np.float64]:
    vector = np.asarray(value, np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"The {name} is {value!r}; it must be three finite numbers.")
    return vector


def _friction(value: float) -> float:
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"The friction is {value!r}; it must be a number of at least 0.")
    return float(value)


def _adhesion(value: float) -> float:
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"The adhesion is {value!r} Pa; it must be a number of at least 0.")
    return float(value)


def _rows(values: ArrayLike, count: int, width: int, name: str) -> NDArray[np.float32]:
    array = np.asarray(values, np.float32)
    if array.shape == (width,):
        array = np.tile(array, (count, 1))
    if array.shape != (count, width):
        raise ValueError(f"The {name} have shape {array.shape}; expected ({count}, {width}).")
    if not np.isfinite(array).all():
        raise ValueError(f"The {name} have values that are not finite.")
    return array
