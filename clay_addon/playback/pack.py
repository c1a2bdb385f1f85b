# SPDX-License-Identifier: GPL-3.0-or-later
"""Pack Playback: baked frames stored in the .blend and played by Blender's own nodes.

Every frame is a vector attribute of the point cloud, and a geometry nodes modifier moves the points
to the attribute of the scene's frame. So the file plays and renders without add-on and cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress

import bpy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...solver.core.errors import TactileClayError
from ..base.clock import drive_frame, go_to, shown_moment
from ..base.mesh_geometry import local_from_world, transform
from ..clay.look import input_path, set_input
from ..core.storage.cache import Cache, CacheError
from ..core.storage.playback import Playback, held_frame
from ..model.clay_scene import clay_objects
from .packed import FRAME_ATTRIBUTE, MODIFIER_NAME, is_packed, packed_attributes
from .playback import cache_of, is_bake_of, paused, refresh
from .shown_clay import moves

NODE_GROUP_NAME = "Clay Playback"
_FRAME = "Frame"
_MARK = "tactile_clay_playback"
_VERSION = 3
_FLOAT_EXACT = 2**24
"""Largest frame number that the nodes, which compute in single precision, represent exactly."""


class PackError(TactileClayError, ValueError):
    """Frames cannot be packed; the message says why and what to do."""


def pack(clay: bpy.types.Object, frames: Mapping[int, ArrayLike], *, hold: int = 1) -> None:
    """Store frames in a point cloud and make it play them.

    It shows the first frame before the range, the last one after it, and interpolates linearly at
    subframes, as for motion blur. Previously packed frames are replaced; if an error is raised,
    nothing has changed. The point cloud's own positions do not change.

    Args:
        clay: Point cloud object.
        frames: Positions in the object's coordinates [Blender units], shape [N, 3], by frame
            number: every `hold`-th frame without gaps.
        hold: Number of frames for which each shape is held; above 1 without interpolation.

    Raises:
        PackError: The object is not a point cloud or is linked from another file, or frames are
            missing, of the wrong shape, or not finite.
    """
    checked = _checked_frames(clay, frames, hold)
    _remove_attributes(clay)
    for number, positions in checked.items():
        layer = clay.data.attributes.new(f"{FRAME_ATTRIBUTE}{number}", "FLOAT_VECTOR", "POINT")
        layer.data.foreach_set("vector", positions.ravel())
    modifier = clay.modifiers.get(MODIFIER_NAME)
    if modifier is None:
        modifier = clay.modifiers.new(MODIFIER_NAME, "NODES")
        clay.modifiers.move(len(clay.modifiers) - 1, 0)
    modifier.node_group = _playback_group()
    set_input(modifier, "First Frame", min(checked))
    set_input(modifier, "Last Frame", max(checked))
    set_input(modifier, "Hold", hold)
    drive_frame(clay, input_path(modifier, _FRAME))
    clay.data.update_tag()


def unpack(clay: bpy.types.Object) -> bool:
    """Remove packed frames from an object.

    Returns:
        Whether there were any.
    """
    modifier = clay.modifiers.get(MODIFIER_NAME)
    found = is_packed(clay)
    if modifier is not None:
        with suppress(KeyError):
            clay.driver_remove(input_path(modifier, _FRAME))
        clay.modifiers.remove(modifier)
    if clay.type == "POINTCLOUD":
        _remove_attributes(clay)
        clay.data.update_tag()
    return found


def pack_bake(scene: bpy.types.Scene, cache: Cache | None = None) -> dict[str, int]:
    """Pack all baked frames of a scene's clay.

    Args:
        scene: The scene.
        cache: The bake; by default the scene's.

    Returns:
        ``frame_start`` and ``frame_end``, and the number of ``objects`` and ``bytes`` packed.

    Raises:
        PackError: There is no clay or no bake, it is of different clay, or a frame is missing.
        CacheError: The cache cannot be read.
    """
    clay = clay_objects(scene)
    if not clay:
        raise PackError("There is no clay in this scene.")
    cache = cache or cache_of(scene)
    numbers = cache.frames() if cache else []
    hold = scene.tactile_clay.hold_frames
    if cache is None or not numbers:
        raise PackError("There is no bake to pack. Bake first.")
    playback = Playback(cache)
    meta = playback.meta()
    if not is_bake_of(meta, clay):
        raise PackError("The bake is of other clay than the scene has now. Bake again.")
    # A bake is in the world, packed shapes go with their object. So an object that moves needs a
    # shape for every frame, also where the bake holds its shapes.
    holds = [1 if moves(item) else hold for item in clay]
    shapes: list[dict[int, NDArray[np.float32]]] = [{} for _ in clay]
    held = {number: held_frame(number, first=numbers[0], hold=hold) for number in numbers}
    with _matrices(scene, clay, numbers) as inverse_at:
        for number in numbers:
            needed = [each == 1 or held[number] == number for each in holds]
            if not any(needed):
                continue
            world = playback.frame(held[number]).positions
            inverse = inverse_at(number)
            for part, matrix, positions, wanted in zip(shapes, inverse, world, needed, strict=True):
                if wanted:
                    part[number] = transform(matrix, positions).astype(np.float32)
    checked = [
        _checked_frames(item, part, each)
        for item, part, each in zip(clay, shapes, holds, strict=True)
    ]
    for item, part, each in zip(clay, checked, holds, strict=True):
        pack(item, part, hold=each)
    return {
        "frame_start": numbers[0],
        "frame_end": numbers[-1],
        "objects": len(clay),
        "bytes": sum(rows.nbytes for part in checked for rows in part.values()),
    }


@contextmanager
def _matrices(
    scene: bpy.types.Scene, clay: list[bpy.types.Object], numbers: list[int]
) -> Iterator[Callable[[int], list[NDArray[np.float64]]]]:
    """What brings world positions into each object's coordinates at a frame.

    The scene goes from frame to frame only where an object moves, and back at the end.
    """
    previous = shown_moment(scene)

    def still() -> list[NDArray[np.float64]]:
        try:
            return [local_from_world(item) for item in clay]
        except ValueError as error:
            raise PackError(f"{error}.") from error

    if not any(moves(item) for item in clay):
        matrices = still()
        yield lambda _: matrices
        return

    def at(number: int) -> list[NDArray[np.float64]]:
        scene.frame_set(number)
        return still()

    with paused():
        try:
            yield at
        finally:
            go_to(scene, previous)


def _checked_frames(
    clay: bpy.types.Object, frames: Mapping[int, ArrayLike], hold: int
) -> dict[int, NDArray[np.float32]]:
    if clay.type != "POINTCLOUD":
        raise PackError(f"{clay.name!r} is a {clay.type.lower()}, not a point cloud of clay.")
    if clay.library is not None or clay.data.library is not None:
        raise PackError(
            f"{clay.name!r} is linked from another file, so frames packed here would be lost. Pack "
            "it there, or make it local first (Object > Relations > Make Local)."
        )
    if not frames:
        raise PackError("There are no frames to pack.")
    first, last = min(frames), max(frames)
    missing = [number for number in range(first, last + 1, hold) if number not in frames]
    if missing:
        raise PackError(
            f"{len(missing)} frames are missing between {first} and {last}, starting with"
            f" {missing[0]}. Resume the bake, then pack again."
        )
    if max(abs(first), abs(last)) > _FLOAT_EXACT:
        raise PackError(f"Frame numbers beyond {_FLOAT_EXACT:,} cannot be packed.")
    shape = (len(clay.data.points), 3)
    checked = {}
    for number in sorted(frames):
        positions = np.ascontiguousarray(frames[number], dtype=np.float32)
        if positions.shape != shape:
            raise PackError(
                f"Frame {number} has positions of shape {positions.shape}, but"
                f" {clay.name!r} needs {shape}."
            )
        if not np.isfinite(positions).all():
            raise PackError(f"Frame {number} has positions that are not finite.")
        checked[int(number)] = positions
    return checked


def _remove_attributes(clay: bpy.types.Object) -> None:
    # Look up each by name: removing one may move the others in memory.
    for name in packed_attributes(clay):
        clay.data.attributes.remove(clay.data.attributes[name])


def _playback_group() -> bpy.types.NodeTree:
    """The node group for playback, created at the first call."""
    for tree in bpy.data.node_groups:
        if tree.get(_MARK) == _VERSION and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(NODE_GROUP_NAME, "GeometryNodeTree")
    tree[_MARK] = _VERSION
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    socket(_FRAME, in_out="INPUT", socket_type="NodeSocketFloat")
    socket("First Frame", in_out="INPUT", socket_type="NodeSocketInt")
    socket("Last Frame", in_out="INPUT", socket_type="NodeSocketInt")
    socket("Hold", in_out="INPUT", socket_type="NodeSocketInt").default_value = 1
    link = tree.links.new

    def node(kind: str, x: float, y: float, **properties: object) -> bpy.types.Node:
        made = tree.nodes.new(kind)
        made.location = (x, y)
        for name, value in properties.items():
            setattr(made, name, value)
        return made

    def scalar(operation: str, x: float, y: float) -> bpy.types.Node:
        return node("ShaderNodeMath", x, y, operation=operation)

    given = node("NodeGroupInput", -2200, 200)
    # Time remapping turned the frame into a time and the driver turned it back, in single
    # precision: what is as good as a whole frame is one, or a held shape would change too early.
    whole = scalar("ROUND", -2000, 0)
    link(given.outputs[_FRAME], whole.inputs[0])
    beside = scalar("COMPARE", -1800, 0)
    link(given.outputs[_FRAME], beside.inputs[0])
    link(whole.outputs[0], beside.inputs[1])
    beside.inputs[2].default_value = 0.015
    moment = node("ShaderNodeMix", -1600, 0)
    link(beside.outputs[0], moment.inputs[0])
    link(given.outputs[_FRAME], moment.inputs[2])
    link(whole.outputs[0], moment.inputs[3])
    clamped = node("ShaderNodeClamp", -1200, 0)
    link(moment.outputs[0], clamped.inputs["Value"])
    link(given.outputs["First Frame"], clamped.inputs["Min"])
    link(given.outputs["Last Frame"], clamped.inputs["Max"])
    # If held for n > 1 frames, round down to the first frame plus a multiple of n.
    since = scalar("SUBTRACT", -1200, -300)
    link(clamped.outputs[0], since.inputs[0])
    link(given.outputs["First Frame"], since.inputs[1])
    over = scalar("MODULO", -1050, -300)
    link(since.outputs[0], over.inputs[0])
    link(given.outputs["Hold"], over.inputs[1])
    holds = scalar("GREATER_THAN", -1200, -480)
    link(given.outputs["Hold"], holds.inputs[0])
    holds.inputs[1].default_value = 1.5
    late = scalar("MULTIPLY", -900, -300)
    link(over.outputs[0], late.inputs[0])
    link(holds.outputs[0], late.inputs[1])
    shown = scalar("SUBTRACT", -1050, -100)
    link(clamped.outputs[0], shown.inputs[0])
    link(late.outputs[0], shown.inputs[1])
    places = []
    for operation, y in (("FLOOR", 0), ("CEIL", -250)):
        whole = scalar(operation, -1000, y)
        link(shown.outputs[0], whole.inputs[0])
        text = node("FunctionNodeValueToString", -800, y, data_type="INT")
        link(whole.outputs[0], text.inputs["Value"])
        name = node("FunctionNodeReplaceString", -600, y)
        name.inputs["String"].default_value = f"{FRAME_ATTRIBUTE}#"
        name.inputs["Find"].default_value = "#"
        link(text.outputs[0], name.inputs["Replace"])
        place = node("GeometryNodeInputNamedAttribute", -400, y, data_type="FLOAT_VECTOR")
        link(name.outputs[0], place.inputs["Name"])
        places.append(place.outputs["Attribute"])
    fraction = scalar("FRACT", -400, -450)
    link(shown.outputs[0], fraction.inputs[0])
    change = node("ShaderNodeVectorMath", -200, -150, operation="SUBTRACT")
    link(places[1], change.inputs[0])
    link(places[0], change.inputs[1])
    # At a whole frame this adds exactly 0, so the positions are bit-identical.
    blend = node("ShaderNodeVectorMath", 0, 0, operation="MULTIPLY_ADD")
    link(change.outputs[0], blend.inputs[0])
    link(fraction.outputs[0], blend.inputs[1])
    link(places[0], blend.inputs[2])
    moved = node("GeometryNodeSetPosition", 200, 200)
    link(given.outputs["Geometry"], moved.inputs["Geometry"])
    link(blend.outputs[0], moved.inputs["Position"])
    result = node("NodeGroupOutput", 400, 200)
    link(moved.outputs[0], result.inputs["Geometry"])
    return tree


class CLAY_OT_pack(bpy.types.Operator):  # noqa: N801
    """Store the baked frames in the .blend, so that it plays without the add-on and the cache"""

    bl_idname = "clay.pack"
    bl_label = "Pack Playback"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available if there is clay."""
        return bool(clay_objects(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Pack the frames, or report why they cannot be packed."""
        try:
            packed = pack_bake(context.scene)
        except (PackError, CacheError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report(
            {"INFO"},
            f"Packed frames {packed['frame_start']} to {packed['frame_end']}"
            f" ({packed['bytes'] / 1e6:.1f} MB). Save the file to keep them.",
        )
        return {"FINISHED"}


class CLAY_OT_unpack(bpy.types.Operator):  # noqa: N801
    """Remove the packed frames from the .blend; the clay plays from its cache again"""

    bl_idname = "clay.unpack"
    bl_label = "Unpack Playback"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available if there is packed clay."""
        return any(is_packed(item) for item in clay_objects(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Unpack all clay of the scene."""
        count = sum(unpack(item) for item in clay_objects(context.scene))
        refresh(context.scene)
        self.report({"INFO"}, f"{count} clay objects now play from the cache")
        return {"FINISHED"}


_CLASSES = (CLAY_OT_pack, CLAY_OT_unpack)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
