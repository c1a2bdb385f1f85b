# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes put into Blender, as `random_scenes.py` draws them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
import trimesh
from mathutils import Euler
from numpy.typing import NDArray

from tactile_clay.clay_addon.base.clock import animation_time
from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.model.collider import make_collider
from tactile_clay.tests.reports.random_scenes import Body, Obstacle, SceneSpec, Shell, Vector

BODY_PITCH = 28.0
"""From one clay object to the next along y, in spacings: turned or moved along x, none meet."""
SHELL_PITCH = 8.0
"""From one shell of a mesh to the next along its x, in spacings."""


@dataclass
class Placed:
    """A collider as it was built, and how to see independently of the product where it is."""

    spec: Obstacle
    item: bpy.types.Object

    @property
    def is_flat(self) -> bool:
        """Whether it has no inside."""
        return self.spec.kind in ("table", "shelf") and not self.spec.modifier


@dataclass
class BuiltScene:
    """What stands in Blender now."""

    spec: SceneSpec
    clay: list[bpy.types.Object] = field(default_factory=list)
    """In the order of the bodies."""
    volumes: list[float] = field(default_factory=list)
    """Of the meshes that each clay object was made of [Blender units³]."""
    colliders: list[Placed] = field(default_factory=list)


def _mesh_object(name: str, vertices: Any, faces: Any) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    data.from_pydata(np.asarray(vertices).tolist(), [], np.asarray(faces).tolist())
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    return item


def _joined(meshes: list[tuple[Any, Any]]) -> tuple[Any, Any]:
    starts = [0, *itertools.accumulate(len(vertices) for vertices, _ in meshes)]
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def _linear(item: Any, path: str, index: int, keys: dict[float, float]) -> None:
    """Key a number of a vector at animation times, straight from one to the next."""
    for time, value in keys.items():
        getattr(item, path)[index] = value
        item.keyframe_insert(path, index=index, frame=time)
    for layer in item.animation_data.action.layers:
        for curve in layer.strips[0].channelbags[0].fcurves:
            for key in curve.keyframe_points:
                key.interpolation = "LINEAR"


def _add_body(built: BuiltScene, index: int, body: Body) -> None:
    """Make the meshes of a body, and clay of them."""
    scene, spacing = bpy.context.scene, built.spec.step_length
    meshes = []
    for place, shell in enumerate(body.shells):
        vertices, faces = shell.mesh()
        offset = ((place - (len(body.shells) - 1) / 2) * SHELL_PITCH, 0.0, 0.0)
        meshes.append(((vertices + offset) * spacing, faces))
    if not body.apart:
        vertices, faces = _joined(meshes)
        items = [_mesh_object("Source", vertices, faces)]
    else:
        items = [_mesh_object("Source", *mesh) for mesh in meshes]
    for item in items:
        item.rotation_euler, item.scale = body.turn, body.mirror
        item.location = (0.0, index * BODY_PITCH * spacing, 0.0)
    bpy.context.view_layer.update()
    clay = make_clay(bpy.context, items, spacing, built.spec.material, name=body.name)
    clay.rotation_euler = body.turned_after
    built.clay.append(clay)
    volume = 0.0
    for shell in body.shells:
        plain = Shell(shell.kind, shell.size).mesh()
        full = trimesh.Trimesh(*plain, process=False).volume
        volume += full * (1 - 0.4**3 if shell.hollow else 1)
    built.volumes.append(volume * spacing**3)
    _drive(built.spec, scene, clay, body.drive)


def _drive(spec: SceneSpec, scene: bpy.types.Scene, clay: Any, way: str) -> None:
    """Let something move a clay object along x during the bake."""
    if way == "none":
        return
    first, last = (animation_time(scene, frame) for frame in (spec.start, spec.end))
    mover = bpy.data.objects.new("Mover", None)
    scene.collection.objects.link(mover)
    keys = {first: 0.5 * spec.step_length, last: 9.0 * spec.step_length}
    if way == "keys":
        x = clay.location.x
        _linear(clay, "location", 0, {time: x + value for time, value in keys.items()})
        return
    _linear(mover, "location", 0, keys)
    if way == "parent":
        _linear(mover, "rotation_euler", 2, {first: 0.0, last: 0.7})
        clay.parent = mover
    elif way == "grandparent":
        between = bpy.data.objects.new("Between", None)
        scene.collection.objects.link(between)
        between.parent = mover
        between.rotation_euler, between.scale = (0.0, 0.0, 0.02), (-1.0, 1.0, 1.0)
        clay.parent = between
    elif way == "constraint":
        constraint = clay.constraints.new("COPY_LOCATION")
        constraint.target, constraint.use_offset = mover, True
    elif way == "driver":
        driver = clay.driver_add("location", 0).driver
        variable = driver.variables.new()
        variable.targets[0].id = mover
        variable.targets[0].data_path = "location[0]"
        driver.expression = variable.name
    elif way == "strip":
        clay.animation_data_create()
        track = clay.animation_data.nla_tracks.new()
        strip = track.strips.new("Move", int(np.floor(first)), mover.animation_data.action)
        strip.action_slot = mover.animation_data.action_slot


_OUTWARD: dict[str, Vector] = {
    "below": (0.0, 0.0, -1.0),
    "above": (0.0, 0.0, 1.0),
    "beside": (1.0, 0.0, 0.0),
    "between": (0.0, 1.0, 0.0),
}


def _collider_mesh(spec: Obstacle) -> tuple[Any, Any, float]:
    """Vertices [spacings], faces, and how far it reaches along its z."""
    if spec.kind in ("table", "shelf"):
        size = 60.0 if spec.kind == "table" else 20.0
        corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * 0.5 * size
        faces = np.array([[0, 1, 2, 3]])
        return corners, faces[:, ::-1] if spec.inverted else faces, 0.0
    if spec.kind == "pair":
        shells = [
            (vertices + np.array([x, 0.0, 0.0]), faces)
            for x, turned in ((-5.0, False), (5.0, spec.inverted))
            for vertices, faces in [Shell("box", (6.0, 9.0, 6.0), turned).mesh()]
        ]
        return *_joined(shells), 3.0
    lengths = (14.0, 14.0, 6.0) if spec.kind == "box" else (9.0, 9.0, 9.0)
    vertices, faces = Shell(spec.kind, lengths, spec.inverted).mesh()
    return vertices, faces, 0.5 * lengths[2]


def _add_collider(built: BuiltScene, spec: Obstacle, library: Callable[[Any], Any]) -> None:
    scene, spacing = bpy.context.scene, built.spec.step_length
    vertices, faces, reach = _collider_mesh(spec)
    outward = np.array(_OUTWARD[spec.side])
    points = world_points(built.clay[0])
    face = points[np.argmax(points @ outward)] @ outward
    turn = Euler(spec.tilt).to_quaternion()
    turn = (
        turn
        @ Euler(
            {"beside": (0.0, np.pi / 2, 0.0), "between": (np.pi / 2, 0.0, 0.0)}.get(
                spec.side, (0.0, 0.0, 0.0)
            )
        ).to_quaternion()
    )
    item = _mesh_object(spec.name, vertices * spacing, faces)
    item.rotation_mode = "QUATERNION"
    item.rotation_quaternion = turn
    item.scale = spec.mirror
    middle = points.mean(0) * (1 - np.abs(outward))
    # Half a spacing is between the outermost particles and the clay's surface.
    item.location = (middle + outward * (face + (spec.gap + 0.5 + reach) * spacing)).tolist()
    if spec.modifier:
        if spec.kind in ("table", "shelf"):
            item.modifiers.new("Thick", "SOLIDIFY").thickness = 2.0 * spacing
        else:
            item.modifiers.new("Finer", "SUBSURF")
    if spec.linked:
        item = library(item)
    bpy.context.view_layer.update()
    make_collider(item)
    built.colliders.append(Placed(spec, item))
    _move(built.spec, scene, item, spec.motion, outward)
    _switch(built.spec, scene, item, spec.presence)


def _move(
    spec: SceneSpec, scene: bpy.types.Scene, item: Any, motion: str, outward: NDArray[np.float64]
) -> None:
    first, last = (animation_time(scene, frame) for frame in (spec.start, spec.end))
    frames = spec.length - 1
    far = {"press": -0.8, "toward": -0.3, "away": 0.4, "fast": -3.0, "jump": -60.0}.get(motion)
    axis = int(np.abs(outward).argmax())
    place = item.location[axis]
    if far is not None:
        end = place + far * outward[axis] * spec.step_length * frames
        _linear(item, "location", axis, {first: place, last: end})
    elif motion == "slide":
        axis = (axis + 1) % 3
        place = item.location[axis]
        _linear(item, "location", axis, {first: place, last: place + spec.step_length * frames})
    elif motion == "turn":
        item.rotation_mode = "XYZ"
        item.rotation_euler = item.rotation_quaternion.to_euler()
        angle = item.rotation_euler[2]
        _linear(item, "rotation_euler", 2, {first: angle, last: angle + 0.2 * frames})
    elif motion == "carried":
        carrier = bpy.data.objects.new("Carrier", None)
        scene.collection.objects.link(carrier)
        far = -0.8 * float(outward[axis]) * spec.step_length * frames
        _linear(carrier, "location", axis, {first: 0.0, last: far})
        item.parent = carrier
    elif motion == "wheel":
        item.tactile_clay.wheel_speed = 90.0
    elif motion == "swell":
        size = item.scale[2]
        _linear(item, "scale", 2, {first: size, last: size * (1 + 0.03 * frames)})
    elif motion == "deform" and item.library is None and item.override_library is None:
        item.shape_key_add(name="Basis")
        key = item.shape_key_add(name="Up")
        for point in key.data:
            point.co.x *= 1.1
        for time, value in ((first, 0.0), (last, 1.0)):
            key.value = value
            key.keyframe_insert("value", frame=time)


def _key_switch(item: Any, path: str, keys: dict[float, bool]) -> None:
    owner = item.tactile_clay if path == "collider_enabled" else item
    for time, value in keys.items():
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=time)


def _switch(spec: SceneSpec, scene: bpy.types.Scene, item: Any, presence: str) -> None:
    first, middle = (animation_time(scene, frame) for frame in (spec.start, spec.start + 1))
    if presence in ("keyed off", "keyed on"):
        off = presence == "keyed off"
        _key_switch(item, "hide_viewport", {first: not off, middle: off})
    elif presence in ("lifted", "set down"):
        on = presence == "set down"
        _key_switch(item, "collider_enabled", {first: not on, middle: on})
    elif presence == "off":
        item.hide_viewport = True
    elif presence == "eye":
        item.hide_set(True)
    elif presence == "camera":
        item.hide_render = True
    elif presence == "collection":
        inner = bpy.data.collections.new("Off")
        scene.collection.children.link(inner)
        for collection in item.users_collection:
            collection.objects.unlink(item)
        inner.objects.link(item)
        inner.hide_viewport = True


def world_points(clay: bpy.types.Object) -> NDArray[np.float64]:
    """World positions of a clay object's points, shape [N, 3]."""
    values = np.empty((len(clay.data.points), 3), np.float32)
    clay.data.attributes["position"].data.foreach_get("vector", values.ravel())
    matrix = np.array(clay.matrix_world, np.float64)
    return values @ matrix[:3, :3].T + matrix[:3, 3]


def build(spec: SceneSpec, library: Callable[[Any], Any]) -> BuiltScene:
    """Put a scene into an empty Blender.

    Args:
        spec: What to build.
        library: Puts an object into another file and gives a library override of it.

    Raises:
        TactileClayError: The product refuses a part of it.
    """
    scene = bpy.context.scene
    scene.unit_settings.scale_length = spec.unit
    scene.unit_settings.system = spec.units
    scene.tactile_clay.hold_frames = spec.hold
    scene.render.fps, scene.render.fps_base = spec.rate
    scene.render.frame_map_old, scene.render.frame_map_new = spec.remap
    scene.frame_step = spec.step
    if spec.scene_range:
        # Blender keeps frame ranges from going below 0.
        scene.frame_start, scene.frame_end = max(spec.start, 0), max(spec.end, 0)
    scene.tactile_clay.use_scene_range = spec.scene_range
    scene.tactile_clay.frame_start, scene.tactile_clay.frame_end = spec.start, spec.end
    scene.tactile_clay.motion_samples = spec.samples
    scene.use_gravity = spec.gravity != "off"
    if spec.gravity in ("down", "sideways"):
        pull = 9.81 / spec.unit
        scene.gravity = (0.0, 0.0, -pull) if spec.gravity == "down" else (pull, 0.0, 0.0)
    scene.frame_set(spec.start)
    built = BuiltScene(spec)
    for index, body in enumerate(spec.bodies):
        _add_body(built, index, body)
    scene.frame_set(spec.start)
    for obstacle in spec.obstacles:
        _add_collider(built, obstacle, library)
    clay = built.clay[-1]
    if spec.hidden_clay == "H":
        clay.hide_set(True)
    elif spec.hidden_clay == "keyed":
        times = [animation_time(scene, spec.start + offset) for offset in (0, 1)]
        _key_switch(clay, "hide_viewport", {times[0]: False, times[1]: True})
    elif spec.hidden_clay == "monitor":
        clay.hide_viewport = True
    elif spec.hidden_clay == "camera":
        clay.hide_render = True
    return built
