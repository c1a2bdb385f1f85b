# SPDX-License-Identifier: GPL-3.0-or-later
"""Random Blender scenes, as hypothesis draws them; `built_scenes.py` builds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from hypothesis import strategies as st
from numpy.typing import NDArray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Shell:
    """One closed surface of a mesh; lengths in spacings."""

    kind: str = "box"
    size: Vector = (4.0, 4.0, 4.0)
    inverted: bool = False
    hollow: bool = False

    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Vertices and triangles around the origin."""
        if self.kind == "box":
            shape = trimesh.creation.box(self.size)
        else:
            shape = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
            shape.apply_scale(self.size)
        vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
        if self.inverted:
            faces = faces[:, ::-1]
        if self.hollow:
            # A cavity is wound the other way round than what is around it.
            count = len(vertices)
            vertices = np.concatenate([vertices, 0.4 * vertices])
            faces = np.concatenate([faces, faces[:, ::-1] + count])
        return vertices, faces


@dataclass(frozen=True)
class Body:
    """What becomes one clay object."""

    shells: tuple[Shell, ...] = (Shell(),)
    apart: bool = False
    """Whether each shell is an object of its own."""
    turn: Vector = (0.0, 0.0, 0.0)
    mirror: Vector = (1.0, 1.0, 1.0)
    turned_after: Vector = (0.0, 0.0, 0.0)
    """Rotation of the clay object, once it is clay."""
    drive: str = "none"
    """What moves the clay object during the bake."""
    name: str = "Clay"


@dataclass(frozen=True)
class Obstacle:
    """A collider."""

    kind: str = "table"
    """``box``, ``ball`` or ``pair``, which are closed; ``table`` or ``shelf``, which are flat."""
    side: str = "below"
    """Of the first body: ``below``, ``above``, ``beside``, or ``between`` it and the second."""
    gap: float = 0.5
    """From the clay to it, in spacings."""
    tilt: Vector = (0.0, 0.0, 0.0)
    mirror: Vector = (1.0, 1.0, 1.0)
    inverted: bool = False
    motion: str = "still"
    presence: str = "there"
    """Whether, and how, it is switched off for a part of the time."""
    modifier: bool = False
    """Whether it has one: flat ones are solidified, closed ones subdivided."""
    linked: bool = False
    """Whether it is a library override of one in another file."""
    name: str = "Board"


@dataclass(frozen=True)
class SceneSpec:
    """All of a random scene."""

    bodies: tuple[Body, ...] = (Body(),)
    obstacles: tuple[Obstacle, ...] = ()
    spacing: float = 0.01
    """[m]"""
    unit: float = 1.0
    """Length of a Blender unit [m]."""
    rate: tuple[int, float] = (24, 1.0)
    remap: tuple[int, int] = (100, 100)
    start: int = 1
    length: int = 3
    step: int = 1
    current: float = 0.0
    """Where the scene stands before the bake, in frames after its start."""
    gravity: str = "down"
    samples: int = 1
    scene_range: bool = True
    packs: bool = False
    delivers: bool = False
    resumes: bool = False
    hidden_clay: str = "no"
    hold: int = 1
    """Frames that playback shows each shape for."""
    units: str = "METRIC"
    material: str = "plasticine"

    @property
    def end(self) -> int:
        """Last frame."""
        return self.start + self.length - 1

    @property
    def step_length(self) -> float:
        """The spacing [Blender units]."""
        return self.spacing / self.unit


def _vectors(*values: float) -> st.SearchStrategy[Vector]:
    return st.tuples(*[st.sampled_from(values)] * 3)


SHELLS = st.builds(
    Shell,
    kind=st.sampled_from(["box", "ball"]),
    size=_vectors(4.0, 3.0, 5.0, 6.0, 3.4),
    inverted=st.booleans(),
)
HOLLOW = st.builds(
    Shell, st.just("box"), st.just((7.0, 7.0, 7.0)), inverted=st.booleans(), hollow=st.just(True)
)
TURNS = st.one_of(st.just((0.0, 0.0, 0.0)), _vectors(0.0, 0.3, -1.2, np.pi / 2, np.pi))
MIRRORS = _vectors(1.0, -1.0)
NAMES = st.sampled_from(["Clay", "Clay.001", "Ton ü", "A", "粘土"])
DRIVES = ["none", "keys", "parent", "grandparent", "constraint", "driver", "strip"]
MOTIONS = [
    *["press", "toward", "press", "fast", "still", "away"],
    *["slide", "jump", "turn", "swell", "deform", "carried", "wheel"],
]
PRESENCES = [
    *["there"] * 6,
    *["keyed off", "keyed on", "lifted", "set down"],
    *["off", "collection", "eye", "camera"],
]
BODIES = st.builds(
    Body,
    shells=st.one_of(
        st.lists(SHELLS, min_size=1, max_size=3).map(tuple), st.tuples(HOLLOW), st.tuples(SHELLS)
    ),
    apart=st.booleans(),
    turn=TURNS,
    mirror=MIRRORS,
    turned_after=st.one_of(st.just((0.0, 0.0, 0.0)), _vectors(0.0, 0.1, np.pi)),
    drive=st.sampled_from(DRIVES),
    name=NAMES,
)
_PLACES: dict[str, st.SearchStrategy] = {
    "side": st.sampled_from(["below", "above", "beside", "between"]),
    "gap": st.sampled_from([0.5, 0.1, 1.5, 0.3, -0.3, 4.0, -2.0]),
    "tilt": st.one_of(st.just((0.0, 0.0, 0.0)), _vectors(0.0, 0.05, np.pi)),
    "mirror": MIRRORS,
    "inverted": st.booleans(),
    "modifier": st.sampled_from([False, False, True]),
    "linked": st.sampled_from([False, False, False, True]),
    "name": st.sampled_from(["Board", "Board.001", "Flügel", "0"]),
}
FLAT = st.builds(
    Obstacle,
    kind=st.sampled_from(["table", "shelf"]),
    # An endless plane that moves or vanishes is refused: seldom, so that most scenes are baked.
    motion=st.sampled_from([*["still"] * 8, *MOTIONS]),
    presence=st.sampled_from([*["there"] * 8, "eye", "camera", "off", "collection", *PRESENCES]),
    **_PLACES,
)
CLOSED = st.builds(
    Obstacle,
    kind=st.sampled_from(["box", "ball", "pair"]),
    motion=st.sampled_from(MOTIONS),
    presence=st.sampled_from(PRESENCES),
    **_PLACES,
)
OBSTACLES = st.one_of(CLOSED, FLAT)
SCENES = st.builds(
    SceneSpec,
    bodies=st.lists(BODIES, min_size=1, max_size=3).map(tuple),
    obstacles=st.one_of(
        st.lists(CLOSED, min_size=1, max_size=2), st.lists(OBSTACLES, max_size=3)
    ).map(tuple),
    spacing=st.sampled_from([0.01, 0.005, 0.02]),
    unit=st.sampled_from([1.0, 0.1, 0.01]),
    rate=st.sampled_from([(24, 1.0), (24, 1.001), (30, 1.0), (60, 1.0)]),
    remap=st.sampled_from([(100, 100), (100, 200), (200, 100), (100, 90)]),
    start=st.sampled_from([1, 0, -1, -7, 1001]),
    length=st.sampled_from([4, 3, 5, 2]),
    step=st.sampled_from([1, 3]),
    current=st.sampled_from([0.0, 2.0, -3.0, 1.5, 40.0]),
    gravity=st.sampled_from(["down", "off", "as it was", "sideways"]),
    samples=st.sampled_from([1, 1, 3]),
    scene_range=st.booleans(),
    packs=st.booleans(),
    delivers=st.sampled_from([False, False, False, False, False, True]),
    resumes=st.sampled_from([False, False, False, True]),
    hidden_clay=st.sampled_from([*["no"] * 12, "H", "H", "camera", "monitor", "keyed"]),
    hold=st.sampled_from([1, 1, 1, 2]),
    units=st.sampled_from(["METRIC", "IMPERIAL", "NONE"]),
    material=st.sampled_from(["plasticine", "wet_clay"]),
)
