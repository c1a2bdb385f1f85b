# SPDX-License-Identifier: GPL-3.0-or-later
"""Potter's wheels: colliders that spin about their local Z axis at a given speed.

A wheel is turned by an *axle*, an object outside any scene that rotates about Z. A constraint of
the wheel copies the axle's rotation. The axle has a keyframe in each frame, with the integral of
the speed as its value, so a wheel plays, renders and bakes like any animated object, even without
this extension. The rest of the wheel's transform can still be set or animated. In a live session,
`live.LiveWheels` turns the axle in real time.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..base.app_handlers import add_handlers, remove_handlers
from ..base.clock import animation_time, go_to, shown_moment
from ..base.signals import wheels_changed
from ..model.properties import frame_range
from .speed import frame_turns, is_driven, sampled_frame_turns, speed_curve

CONSTRAINT_NAME = "Clay Wheel"
_STAMP = "tactile_clay_wheel"
"""Custom property of an axle: a digest of the inputs that its curve was made from."""
_LINEAR = 1
_MAX_TURN = math.radians(170.0)
"""Maximum turn per frame [rad]: from half a turn on, the direction is ambiguous."""

live_scenes: set[int] = set()
"""``session_uid`` of the scenes whose wheels are turned by `live.LiveWheels`."""


class WheelError(TactileClayError):
    """A wheel cannot turn as it should; the message says why and what to do."""


def is_wheel(item: bpy.types.Object) -> bool:
    """Whether an object is a collider with a nonzero or animated wheel speed."""
    properties = item.tactile_clay
    return properties.role == "COLLIDER" and bool(
        properties.wheel_speed or speed_curve(item) is not None or is_driven(item)
    )


def wheel_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The wheels of a scene, sorted by name."""
    return sorted((i for i in scene.objects if is_wheel(i)), key=lambda item: item.name)


def axle_angle(item: bpy.types.Object) -> float:
    """Current angle of a wheel [rad]."""
    axle = item.tactile_clay.wheel_axle
    return axle.rotation_euler[2] if axle is not None else 0.0


# On the timeline -------------------------------------------------------------------------------


def refresh(scene: bpy.types.Scene) -> None:
    """Rewrite the keyframes of a scene's axles where speeds, frames or phases have changed.

    Driven wheels keep the keyframes written by `sample`.
    """
    if scene.session_uid in live_scenes:
        return
    taken: set[bpy.types.Object] = set()
    start, low, high = _frames(scene)
    times = _times(scene, low, high)
    duration = scene.render.fps_base / scene.render.fps
    for item in list(scene.objects):
        if item.tactile_clay.wheel_axle is None and not is_wheel(item):
            continue
        if not is_wheel(item):
            _remove_axle(item)
        elif not is_driven(item):
            axle = ensure_axle(item, taken)
            # A live session leaves it muted in a file saved meanwhile.
            curve = angle_curve(axle)
            if curve is not None and curve.mute:
                curve.mute = False
            stamp = _stamp(item, start, times, duration)
            if axle.get(_STAMP) != stamp:
                _write(item, axle, frame_turns(item, times, duration), times, start - low)
                axle[_STAMP] = stamp


def sample(scene: bpy.types.Scene) -> None:
    """Like `refresh`, but also step through the scene to sample the speed of driven wheels.

    The scene's current frame is restored afterwards.
    """
    refresh(scene)
    driven = [item for item in wheel_objects(scene) if is_driven(item)]
    if not driven or scene.session_uid in live_scenes:
        return
    start, low, high = _frames(scene)
    previous = shown_moment(scene)
    speeds = np.empty((len(driven), high + 1 - low))
    for number in range(low, high + 1):
        scene.frame_set(number)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        for row, item in zip(speeds, driven, strict=True):
            row[number - low] = item.evaluated_get(depsgraph).tactile_clay.wheel_speed
    taken = {item.tactile_clay.wheel_axle for item in wheel_objects(scene) if item not in driven}
    times = _times(scene, low, high)
    duration = scene.render.fps_base / scene.render.fps
    for row, item in zip(speeds, driven, strict=True):
        axle = ensure_axle(item, taken)
        _write(item, axle, sampled_frame_turns(row, duration), times, start - low)
        axle[_STAMP] = "sampled"
    go_to(scene, previous)


def check_speeds(scene: bpy.types.Scene) -> None:
    """Check that no wheel turns so far in one frame that a bake could not follow it.

    Raises:
        WheelError: One does; the message names it and says what to do.
    """
    start, end = frame_range(scene)
    for item in wheel_objects(scene):
        curve = angle_curve(item.tactile_clay.wheel_axle)
        if curve is None or end <= start:
            continue
        angles = np.array([curve.evaluate(time) for time in _times(scene, start, end)])
        steps = np.abs(np.diff(angles))
        if steps.max() > _MAX_TURN:
            worst = int(steps.argmax())
            raise WheelError(
                f"{item.name!r} turns by {math.degrees(steps[worst]):.0f} degrees from frame "
                f"{start + worst} to the next; half a turn cannot be followed. Lower its wheel "
                "speed, or raise the frame rate."
            )


def _frames(scene: bpy.types.Scene) -> tuple[int, int, int]:
    """The frame at which a wheel has its phase, and the first and last frame to key."""
    start, end = frame_range(scene)
    low = min(start, scene.frame_start)
    return start, low, max(end, scene.frame_end, low + 1)


def _times(scene: bpy.types.Scene, low: int, high: int) -> NDArray[np.float64]:
    """Animation times of the frames to key."""
    return np.array([animation_time(scene, number) for number in range(low, high + 1)])


def _stamp(item: bpy.types.Object, start: int, times: NDArray[np.float64], duration: float) -> str:
    """What decides the angles, in short."""
    properties = item.tactile_clay
    curve = speed_curve(item)
    parts: list[object] = [start, times[0], times[-1], duration, properties.wheel_phase]
    if curve is None:
        parts.append(properties.wheel_speed)
    elif len(curve.modifiers):
        parts += [curve.evaluate(time) for time in times]
    else:
        points = curve.keyframe_points
        parts.append(curve.extrapolation)
        for name, width in (("co", 2), ("handle_left", 2), ("handle_right", 2)):
            values = np.empty(width * len(points), np.float32)
            points.foreach_get(name, values)
            parts.append(values.tobytes())
        parts += [(p.interpolation, p.easing, p.back, p.amplitude, p.period) for p in points]
    return hashlib.blake2b(repr(parts).encode(), digest_size=16).hexdigest()


def _write(
    item: bpy.types.Object,
    axle: bpy.types.Object,
    steps: NDArray[np.float64],
    times: NDArray[np.float64],
    start: int,
) -> None:
    """Insert a keyframe for an axle in each frame.

    Args:
        item: The axle's wheel.
        axle: The axle.
        steps: The angle it turns by from frame to frame [rad].
        times: Animation times of the frames.
        start: Which of them it has the wheel's phase at.
    """
    angles = np.concatenate([[0.0], np.cumsum(steps)])
    angles += item.tactile_clay.wheel_phase - angles[start]
    curve = angle_curve(axle)
    if curve is None:
        axle.animation_data_clear()
        axle.keyframe_insert("rotation_euler", index=2, frame=times[0])
        curve = angle_curve(axle)
        assert curve is not None
    points = curve.keyframe_points
    if len(points) > len(angles):
        points.clear()
    points.add(len(angles) - len(points))
    points.foreach_set("co", np.column_stack([times, angles]).astype(np.float32).ravel())
    points.foreach_set("interpolation", np.full(len(angles), _LINEAR, np.int32))
    curve.extrapolation = "LINEAR"
    curve.mute = False
    curve.update()
    axle.animation_data.action.update_tag()
    axle.update_tag()


# Axles -----------------------------------------------------------------------------------------


def ensure_axle(item: bpy.types.Object, taken: set[bpy.types.Object]) -> bpy.types.Object:
    """The axle of a wheel, created if necessary.

    Args:
        item: The wheel.
        taken: Axles of other wheels, to which this one is added. A copied wheel still refers to
            the original's axle, and gets its own.
    """
    properties = item.tactile_clay
    axle = properties.wheel_axle
    if axle is None or axle in taken:
        axle = bpy.data.objects.new(f"{item.name} axle", None)
        properties.wheel_axle = axle
    taken.add(axle)
    constraint = item.constraints.get(CONSTRAINT_NAME)
    if constraint is None or constraint.type != "COPY_ROTATION":
        constraint = item.constraints.new("COPY_ROTATION")
        constraint.name = CONSTRAINT_NAME
        # The axle's rotation is applied first, then the wheel's own transform.
        constraint.mix_mode = "AFTER"
        constraint.owner_space = constraint.target_space = "WORLD"
    if constraint.target != axle:
        constraint.target = axle
    return axle


def _remove_axle(item: bpy.types.Object) -> None:
    """Remove axle and constraint from an object that no longer spins."""
    axle = item.tactile_clay.wheel_axle
    item.tactile_clay.wheel_axle = None
    constraint = item.constraints.get(CONSTRAINT_NAME)
    if constraint is not None:
        item.constraints.remove(constraint)
    if axle.users == 0:
        action = axle.animation_data.action if axle.animation_data else None
        bpy.data.objects.remove(axle)
        if action is not None and action.users == 0:
            bpy.data.actions.remove(action)


def angle_curve(axle: bpy.types.Object | None) -> bpy.types.FCurve | None:
    """The F-curve of an axle's angle; None if it is not keyed."""
    animation = axle.animation_data if axle is not None else None
    if animation is None or animation.action is None or animation.action_slot is None:
        return None
    for layer in animation.action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(animation.action_slot)
            if bag is not None:
                return bag.fcurves.find("rotation_euler", index=2)
    return None


# Handlers --------------------------------------------------------------------------------------


@persistent
def _on_change(scene: bpy.types.Scene | None, *_: object) -> None:
    scenes: Sequence[bpy.types.Scene] = [scene] if scene else list(bpy.data.scenes)
    for each in scenes:
        refresh(each)


@persistent
def _on_save(*_: object) -> None:
    for scene in bpy.data.scenes:
        refresh(scene)


@persistent
def _on_load(*_: object) -> None:
    live_scenes.clear()


_HANDLERS = (("frame_change_pre", _on_change), ("save_pre", _on_save), ("load_pre", _on_load))


def register() -> None:
    """Add the handlers and listen for changed wheels."""
    add_handlers(_HANDLERS)
    wheels_changed.connect(refresh)


def unregister() -> None:
    """Remove the handlers and stop listening."""
    wheels_changed.disconnect(refresh)
    remove_handlers(_HANDLERS)
    live_scenes.clear()
