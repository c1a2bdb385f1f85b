# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes are baked as they stand, and what cannot be is said in words.

In ``make test`` a hundred scenes are tried, the same each time. ``make fuzz`` tries new ones for
``TACTILE_CLAY_FUZZ_MINUTES``, two hours where that is not set.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, note, seed, settings
from numpy.typing import NDArray

import tactile_clay
from tactile_clay.clay_addon.bake.bake import BakeResult, bake
from tactile_clay.clay_addon.base.clock import shown_moment
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.core.storage.playback import held_frame
from tactile_clay.clay_addon.deliver.delivery import deliver
from tactile_clay.clay_addon.model.clay_scene import clay_objects
from tactile_clay.clay_addon.playback.pack import pack_bake
from tactile_clay.clay_addon.playback.packed import is_packed
from tactile_clay.solver.core.errors import TactileClayError
from tactile_clay.tests.reports.built_scenes import BuiltScene, Placed, build
from tactile_clay.tests.reports.random_scenes import SCENES, SceneSpec
from tactile_clay.tests.reports.test_baked_is_rendered import shown_points

ROUND = 10
"""Scenes that hypothesis draws in one go. Later ones are made of parts of earlier ones, so that
many short goes show more than a long one."""
ROUNDS = 10
"""Goes in `make test`."""
MINUTES = float(os.environ.get("TACTILE_CLAY_FUZZ_MINUTES", "0"))
"""How long to try new scenes; 0 tries the same few."""
DEEP = 0.25
"""Clay deeper than this in a collider is a fault unless it is told, in spacings."""
REFUSALS = [
    "does not touch the clay at frame .*infinite plane",
    "moves at frame .*infinite plane cannot move",
    "has a wheel speed, but an infinite plane stands still",
    "cuts through '.*': its particles lie on both sides",
    "is switched off in the viewport, or its collection is excluded",
]
"""What a scene may be refused for. All else is a fault."""


@contextmanager
def fresh_blender() -> Iterator[Path]:
    """An empty Blender, and a folder with a saved file."""
    tactile_clay.unregister()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    tactile_clay.register()
    folder = Path(tempfile.mkdtemp(prefix="clay_fuzz_"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def library_of(folder: Path) -> Callable[[Any], Any]:
    """What puts an object into a file of its own and links it from there with an override."""

    def link(item: Any) -> Any:
        name, path = item.name, folder / f"library_{item.name}.blend"
        bpy.data.libraries.write(str(path), {item})
        bpy.data.objects.remove(item)
        with bpy.data.libraries.load(str(path), link=True) as (_, into):
            into.objects = [name]
        linked = into.objects[0]
        bpy.context.scene.collection.objects.link(linked)
        override = linked.override_create(remap_local_usages=True)
        if override.name not in bpy.context.scene.objects:
            bpy.context.scene.collection.objects.link(override)
        return override

    return link


def state() -> dict[str, Any]:
    """What a bake must leave as it was."""
    scene = bpy.context.scene
    active = bpy.context.view_layer.objects.active
    state: dict[str, Any] = {
        "moment": round(shown_moment(scene), 4),
        "active": active and active.name,
        "ranges": (scene.frame_start, scene.frame_end, scene.frame_step, scene.use_preview_range),
        "mode": bpy.context.mode,
    }
    for item in scene.objects:
        seen = item.hide_get(), item.hide_viewport, item.hide_render, item.visible_get()
        # Blender does not move what is off.
        place = None if item.hide_viewport else np.round(np.array(item.matrix_world), 5).tolist()
        state[item.name] = (item.select_get(), *seen, place)
    for kind in ("objects", "meshes", "pointclouds", "actions", "collections", "node_groups"):
        state[kind] = sorted(each.name for each in getattr(bpy.data, kind))
    return state


def check_left(before: dict[str, Any]) -> None:
    """The scene is as it was."""
    after = state()
    changed = {
        key: (before.get(key), after.get(key))
        for key in {*before, *after}
        if before.get(key) != after.get(key)
    }
    assert not changed, f"changed by the bake: {changed}"


def check_volume(built: BuiltScene) -> None:
    """The clay holds as much as its meshes."""
    volume = built.spec.step_length**3
    for clay, wanted in zip(built.clay, built.volumes, strict=True):
        assert len(clay.data.points) * volume == pytest.approx(wanted, rel=0.1), clay.name


def check_refusal(error: TactileClayError) -> None:
    """An error is one of those that may be, names what it is about and says what to do."""
    text = str(error)
    known = [pattern for pattern in REFUSALS if re.search(pattern, text)]
    assert known, f"refused: {text}"
    assert any(repr(item.name) in text for item in bpy.context.scene.objects), text
    event(f"refused: {known[0]}")


def frames_of(result: BakeResult) -> dict[int, NDArray[np.float32]]:
    """World positions of all particles at each frame that a bake reports, checked."""
    cache = Cache(result.directory)
    numbers = list(range(result.start, result.end + 1))
    assert cache.frames() == numbers
    assert result.baked + result.kept == len(numbers)
    found = {}
    for number in numbers:
        frame = cache.read_frame(number)
        assert len(frame.positions) == result.particle_count
        assert np.isfinite(frame.positions).all()
        assert np.isfinite(frame.velocities).all()
        found[number] = frame.positions
    return found


def check_shown(built: BuiltScene, frames: dict[int, NDArray[np.float32]], said: str) -> None:
    """The viewport shows the baked clay at each frame, in any order."""
    scene, tolerance = bpy.context.scene, 2e-3 * built.spec.step_length
    layout = Cache(Path(bpy.path.abspath("//clay_cache"))).meta().layout
    numbers = [*frames, min(frames) - 2, max(frames) + 3]
    for number in [*numbers[::-1], *numbers[::2]]:
        scene.frame_set(number)
        known = min(max(number, min(frames)), max(frames))
        wanted = layout.split(frames[held_frame(known, first=min(frames), hold=built.spec.hold)])
        for item, rows in zip(clay_objects(scene), wanted, strict=True):
            # Packed shapes go with their object, which a strip may move outside the bake's range.
            if item.hide_viewport or (number not in frames and is_packed(item)):
                continue
            got = shown_points(item)
            assert got.shape == rows.shape, f"{item.name!r} at frame {number}, {said}"
            off = np.abs(got - rows).max()
            assert off < tolerance, f"{item.name!r} is {off} off at frame {number}, {said}"


def is_present(placed: Placed) -> bool:
    """Whether a person would say that the clay meets a collider at the current frame."""
    item = placed.item
    switched = item.hide_viewport or placed.spec.presence == "collection"
    return bool(not switched and item.tactile_clay.collider_enabled)


def world_mesh(
    item: bpy.types.Object,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """What the viewport shows.

    Returns:
        Vertices, shape [V, 3]; triangles, shape [F, 3]; and which of these are on the left in the
        object's own coordinates, as one body of a pair is.
    """
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    values = np.array([vertex.co for vertex in mesh.vertices], np.float64)
    triangles = np.array([triangle.vertices for triangle in mesh.loop_triangles], np.int64)
    evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world, np.float64)
    left = values[triangles][..., 0].mean(1) < 0.0
    return values @ matrix[:3, :3].T + matrix[:3, 3], triangles, left


def depth_in(placed: Placed, points: NDArray[np.float64]) -> float:
    """How deep the deepest point is in a collider of one or two convex bodies; 0 outside."""
    vertices, triangles, left = world_mesh(placed.item)
    deepest = 0.0
    pair = placed.spec.kind == "pair"
    for body in [triangles[left], triangles[~left]] if pair else [triangles]:
        a, b, c = np.moveaxis(vertices[body], 1, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1)
        whole = length > 1e-9 * length.max()
        a, normals = a[whole], normals[whole] / length[whole, None]
        # Outward, whichever way the faces are wound.
        normals *= np.sign(((a - a.mean(0)) * normals).sum(1))[:, None]
        heights = points @ normals.T - (a * normals).sum(1)
        deepest = max(deepest, float(-heights.max(1).min()))
    return deepest


def plane_of(item: bpy.types.Object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of a flat collider, shape [4, 3], and its unit normal."""
    corners, _, _ = world_mesh(item)
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    return corners, normal / np.linalg.norm(normal)


def over_sheet(
    corners: NDArray[np.float64], points: NDArray[np.float64], margin: float
) -> NDArray[np.bool_]:
    """Which points lie over a rectangle, not near its rim."""
    inner = np.ones(len(points), bool)
    for along in (corners[1] - corners[0], corners[3] - corners[0]):
        length = np.linalg.norm(along)
        place = (points - corners[0]) @ along / length
        inner &= (place > margin) & (place < length - margin)
    return inner


def check_contact(
    built: BuiltScene, frames: dict[int, NDArray[np.float32]], warnings: tuple[str, ...]
) -> None:
    """No clay is inside a collider or has gone through one, unless that is told by its name."""
    scene, deep = bpy.context.scene, DEEP * built.spec.step_length
    layout = Cache(Path(bpy.path.abspath("//clay_cache"))).meta().layout
    for placed in built.colliders:
        name = placed.item.name
        told = any(repr(name) in text for text in warnings)
        before: tuple[NDArray[np.float64], NDArray[np.bool_]] | None = None
        endless: float | None = None
        for number, positions in frames.items():
            scene.frame_set(number)
            if not is_present(placed):
                before = None
                continue
            where = f"{name!r} at frame {number}, and not told: {warnings}"
            points = positions.astype(np.float64)
            # At the first frame clay is where a person put it.
            free = told or number == built.spec.start
            if not placed.is_flat:
                depth = depth_in(placed, points)
                assert free or depth < deep, f"clay {depth / deep * DEEP:.2f} spacings in {where}"
                continue
            corners, normal = plane_of(placed.item)
            heights = (points - corners[0]) @ normal
            if number == built.spec.start:
                endless = one_side(layout.split(heights[:, None]), built.spec.step_length)
            if endless is not None:
                low = float((heights * endless).min())
                assert free or low > -deep, f"clay {low / deep * DEEP:.2f} spacings under {where}"
                continue
            over = over_sheet(corners, points, built.spec.step_length)
            if before is not None:
                through = before[1] & over & (np.sign(before[0]) != np.sign(heights))
                through &= (np.abs(heights) > deep) & (np.abs(before[0]) > deep)
                assert told or not through.any(), f"{through.sum()} particles through {where}"
            before = heights, over


def one_side(heights: list[NDArray[Any]], spacing: float) -> float | None:
    """The side of a plane that all clay is on; None where it is on both."""
    sides = {float(np.sign(np.median(each))) for each in heights}
    if len(sides) > 1:
        return None
    (side,) = sides
    astride = any((each * side < -spacing).mean() > 0.1 for each in heights)
    return None if astride else side


def check_resumed(frames: dict[int, NDArray[np.float32]], spec: SceneSpec) -> None:
    """A bake that is stopped after two frames and goes on gives the same to the last bit."""
    bake(
        bpy.context,
        start=spec.start,
        end=spec.end,
        progress=lambda report: report.done < 2,
    )
    result = bake(bpy.context, start=spec.start, end=spec.end, resume=True)
    for number, positions in frames_of(result).items():
        np.testing.assert_array_equal(positions, frames[number])


def check_delivery(spec: SceneSpec) -> None:
    """What is said to be written is there."""
    result = deliver(bpy.context, kind="usd", start=spec.start, end=spec.end)
    assert result is not None
    assert result.file.is_file()
    assert (result.start, result.end) == (spec.start, spec.end)
    assert result.bytes > 0
    assert result.object_name in bpy.context.scene.objects


def hold(spec: SceneSpec, folder: Path) -> str:
    """Build a scene and bake it, and hold all that must be.

    Returns:
        What became of it, in a word.
    """
    try:
        built = build(spec, library_of(folder))
    except TactileClayError as error:
        check_refusal(error)
        return "not built"
    check_volume(built)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    current = spec.start + spec.current
    bpy.context.scene.frame_set(int(current // 1), subframe=current % 1)
    before = state()
    try:
        result = bake(bpy.context, start=spec.start, end=spec.end)
    except TactileClayError as error:
        check_refusal(error)
        check_left(before)
        return "refused"
    check_left(before)
    note(f"warnings: {result.warnings}")
    assert (result.start, result.end) == (spec.start, spec.end)
    frames = frames_of(result)
    check_contact(built, frames, result.warnings)
    check_shown(built, frames, "from the cache")
    if spec.resumes:
        check_resumed(frames, spec)
    if spec.packs:
        pack_bake(bpy.context.scene)
        check_shown(built, frames, "packed")
    if spec.delivers:
        check_delivery(spec)
    return "baked"


def try_scenes(number: int, tally: Counter[str]) -> None:
    """Let hypothesis draw a few scenes; it shows the simplest that fails.

    Args:
        number: Its seed.
        tally: What became of them.
    """

    @seed(number)
    @settings(
        max_examples=ROUND,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(SCENES)
    def each(spec: SceneSpec) -> None:
        with fresh_blender() as folder:
            tally[hold(spec, folder)] += 1

    each()


@pytest.mark.skipif(MINUTES > 0, reason="new scenes are tried instead")
@pytest.mark.usefixtures("studio")
def test_some_random_scenes() -> None:
    """The same ones each time; most can be baked."""
    tally: Counter[str] = Counter()
    for number in range(ROUNDS):
        try_scenes(number, tally)
    assert tally["baked"] > 0.6 * tally.total(), tally


@pytest.mark.skipif(MINUTES == 0, reason="for hours only: make fuzz")
@pytest.mark.usefixtures("studio")
def test_new_random_scenes() -> None:
    """Others each time, until the time is over; each that fails is printed in its simplest form."""
    tally: Counter[str] = Counter()
    until = time.monotonic() + 60 * MINUTES
    failed: list[int] = []
    number = random.SystemRandom().randrange(2**32)
    while time.monotonic() < until:
        try:
            try_scenes(number, tally)
        except Exception:
            failed.append(number)
            print(f"--- seed {number}\n{traceback.format_exc()}", flush=True)
        print(f"{tally.total()} scenes: {dict(tally)}; failed: {failed}", flush=True)
        number += 1
    assert not failed, f"{len(failed)} rounds of {ROUND} scenes failed, printed above: {failed}"
