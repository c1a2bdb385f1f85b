# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel in Blender: its angle on the timeline, in a bake and in a live session."""

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import BakeError, bake
from tactile_clay.clay_addon.model.clay_scene import SimulationError
from tactile_clay.clay_addon.model.collider import make_collider
from tactile_clay.clay_addon.simulate.simulation import Simulation
from tactile_clay.clay_addon.wheel.live import LiveWheels
from tactile_clay.clay_addon.wheel.speed import RPM, speed_curve
from tactile_clay.clay_addon.wheel.wheel import axle_angle, refresh
from tactile_clay.tests.clay_addon.bake.test_bake import frame_bytes


def add_wheel(studio: Any, speed: float = 0.0) -> Any:
    """A disc 10 mm thick whose upper face is at height 0, at 60 frames per second."""
    bpy.ops.mesh.primitive_cylinder_add(radius=0.1, depth=0.01, location=(0.0, 0.0, -0.005))
    wheel = make_collider(bpy.context.object, "MESH", 2.0)
    studio.scene.render.fps = 60
    studio.scene.frame_end = 61
    wheel.tactile_clay.wheel_speed = speed
    return wheel


def key_speeds(wheel: Any, keys: dict[int, float], interpolation: str = "LINEAR") -> Any:
    """Key a wheel's speed [rpm] by frame."""
    for frame, speed in keys.items():
        wheel.tactile_clay.wheel_speed = speed
        wheel.keyframe_insert("tactile_clay.wheel_speed", frame=frame)
    curve = speed_curve(wheel)
    assert curve is not None
    for key in curve.keyframe_points:
        key.interpolation = interpolation
    return curve


def angle_at(wheel: Any, frame: int) -> float:
    """Angle of the wheel in the world [rad], between -π and π."""
    bpy.context.scene.frame_set(frame)
    matrix = wheel.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
    return math.atan2(matrix[1][0], matrix[0][0])


def apart(first: float, second: float) -> float:
    """Difference between two angles, modulo whole turns [rad]."""
    return abs(math.remainder(first - second, math.tau))


def test_constant_speed_turns_evenly(studio: Any) -> None:
    """Turn by ten degrees per frame at 100 rpm, even before and after the frame range."""
    wheel = add_wheel(studio, 100.0)
    for frame in (-3, 1, 2, 30, 61, 90):
        assert apart(angle_at(wheel, frame), math.radians(10.0 * (frame - 1))) < 1e-5


def test_ramp_turns_by_the_area_below_it(studio: Any) -> None:
    """Integrate linear speed ramps, and keep the angle once the speed is zero."""
    wheel = add_wheel(studio)
    key_speeds(wheel, {1: 0.0, 37: 90.0, 55: 0.0})
    for frame in (2, 19, 37):
        assert apart(angle_at(wheel, frame), 0.5 * 90 / 36 * RPM * (frame - 1) ** 2 / 60) < 1e-5
    whole = 0.5 * 90 * RPM * 54 / 60
    assert apart(angle_at(wheel, 55), whole) < 1e-5
    assert apart(angle_at(wheel, 61), whole) < 1e-5


def test_smooth_speed_agrees_with_a_fine_sum(studio: Any) -> None:
    """Integrate a Bézier curve with a key between frames like a fine Riemann sum."""
    wheel = add_wheel(studio)
    curve = key_speeds(wheel, {1: 0.0, 20: 130.0, 50: 20.0}, "BEZIER")
    curve.keyframe_points[1].co.x = 20.4
    curve.update()
    times = np.arange(1.0, 41.0, 0.001) + 0.0005
    expected = sum(curve.evaluate(time) for time in times) * 0.001 * RPM / 60
    assert apart(angle_at(wheel, 41), expected) < 1e-4


def test_tilted_wheel_spins_about_its_own_axis(studio: Any) -> None:
    """Keep a wheel's location, scale and axis when it is rotated and scaled."""
    wheel = add_wheel(studio, 100.0)
    wheel.rotation_euler = (0.4, -0.3, 0.2)
    wheel.scale = (1.0, 1.0, 2.0)
    bpy.context.view_layer.update()
    studio.scene.frame_set(1)
    first = np.array(wheel.matrix_world)
    studio.scene.frame_set(4)
    turn = np.linalg.solve(first, np.array(wheel.matrix_world))
    assert turn == pytest.approx(np.array(rotation(math.radians(30.0))), abs=1e-5)


def rotation(angle: float) -> list[list[float]]:
    """A rotation about Z, shape [4, 4]."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return [[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def test_wheel_turns_without_the_extension(studio: Any, tmp_path: Path) -> None:
    """Play the wheel of a saved file in a Blender without the extension."""
    wheel = add_wheel(studio, 100.0)
    path = studio.save(tmp_path)
    script = (
        "import bpy, math, os, sys\n"
        f"bpy.ops.wm.open_mainfile(filepath={str(path)!r})\n"
        "bpy.context.scene.frame_set(4)\n"
        f"m = bpy.data.objects[{wheel.name!r}].matrix_world\n"
        "print('ANGLE', math.degrees(math.atan2(m[1][0], m[0][0])), hasattr(bpy.types.Object, "
        "'tactile_clay'))\n"
        "sys.stdout.flush(); os._exit(0)"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    (line,) = [line for line in result.stdout.splitlines() if line.startswith("ANGLE")]
    assert float(line.split()[1]) == pytest.approx(30.0, abs=1e-3)
    assert line.split()[2] == "False"


def test_stopped_wheel_becomes_an_ordinary_object(studio: Any) -> None:
    """Remove constraint and axle when the speed is set back to 0."""
    wheel = add_wheel(studio, 100.0)
    assert len(wheel.constraints) == 1
    objects = set(bpy.data.objects)
    wheel.tactile_clay.wheel_speed = 0.0
    assert (len(wheel.constraints), wheel.tactile_clay.wheel_axle) == (0, None)
    assert len(bpy.data.objects) == len(objects) - 1
    assert len(bpy.data.actions) == 0


def test_copied_wheel_has_its_own_speed(studio: Any) -> None:
    """Turn a wheel and its copy at different speeds."""
    wheel = add_wheel(studio, 100.0)
    copy = wheel.copy()
    studio.scene.collection.objects.link(copy)
    copy.tactile_clay.wheel_speed = 50.0
    assert apart(angle_at(wheel, 4), math.radians(30.0)) < 1e-5
    assert apart(angle_at(copy, 4), math.radians(15.0)) < 1e-5


def test_bake_resumed_in_the_middle_is_the_same(studio: Any, tmp_path: Path) -> None:
    """Bake identical bytes in every frame for clay carried around by a keyframed wheel."""
    studio.clay(location=(0.03, 0.0, 0.02))
    key_speeds(add_wheel(studio), {1: 0.0, 10: 100.0})
    studio.scene.frame_end = 10
    studio.save(tmp_path)
    bake(bpy.context, directory=tmp_path / "whole")
    assert bake(bpy.context, progress=lambda report: report.frame < 6).cancelled
    result = bake(bpy.context, resume=True)
    assert (result.baked, result.kept) == (4, 6)
    assert frame_bytes(tmp_path / "clay_cache") == frame_bytes(tmp_path / "whole")


def test_driven_speed_is_sampled_by_the_bake(studio: Any, tmp_path: Path) -> None:
    """Turn a wheel whose speed is driven by another, keyframed object."""
    studio.clay(location=(0.0, 0.0, 0.02))
    wheel = add_wheel(studio)
    pedal = bpy.data.objects.new("Pedal", None)
    studio.scene.collection.objects.link(pedal)
    for frame, height in ((1, 0.0), (7, 0.6)):
        pedal.location.z = height
        pedal.keyframe_insert("location", frame=frame)
    for curve in pedal.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    driver = wheel.driver_add("tactile_clay.wheel_speed").driver
    driver.type = "SUM"
    variable = driver.variables.new()
    variable.type = "TRANSFORMS"
    variable.targets[0].id = pedal
    variable.targets[0].transform_type = "LOC_Z"
    studio.scene.frame_end = 7
    studio.save(tmp_path)
    bake(bpy.context)
    assert apart(angle_at(wheel, 7), 0.5 * 0.6 * RPM * 6 / 60) < 1e-6


def test_wheel_too_fast_for_the_frame_rate_is_refused(studio: Any, tmp_path: Path) -> None:
    """Refuse a wheel that turns by about half a turn per frame."""
    studio.clay(location=(0.0, 0.0, 0.02))
    add_wheel(studio, 300.0)
    studio.scene.render.fps = 10
    studio.scene.frame_end = 3
    studio.save(tmp_path)
    with pytest.raises(
        BakeError, match=r"turns by 180 degrees from frame 1 .*raise the frame rate"
    ):
        bake(bpy.context)


@pytest.mark.parametrize(("rate", "refused"), [(10, True), (12, False)])
@pytest.mark.parametrize("stretch", [50, 200])
def test_time_stretching_makes_no_wheel_faster(
    studio: Any, tmp_path: Path, rate: int, refused: bool, stretch: int
) -> None:
    """What counts is how far a wheel turns from a frame to the next, by the scene's own clock."""
    studio.clay(location=(0.0, 0.0, 0.02))
    add_wheel(studio, 300.0)
    studio.scene.render.fps = rate
    studio.scene.render.frame_map_new = stretch
    studio.scene.frame_end = 3
    studio.save(tmp_path)
    if refused:
        with pytest.raises(BakeError, match="turns by 180 degrees"):
            bake(bpy.context)
    else:
        assert bake(bpy.context).baked == 3


def test_endless_plane_cannot_be_a_wheel(studio: Any) -> None:
    """Refuse a flat collider with a wheel speed."""
    studio.clay(location=(0.0, 0.0, 0.03))
    studio.table().tactile_clay.wheel_speed = 100.0
    with pytest.raises(SimulationError, match="'Table' has a wheel speed, but an infinite plane"):
        Simulation(bpy.context)


def test_live_wheel_follows_speed_changes_immediately(studio: Any) -> None:
    """Turn in real time at the current speed, and keep the angle when the session ends."""
    wheel = add_wheel(studio, 100.0)
    wheels = LiveWheels(studio.scene)
    wheels.advance(studio.scene, 1 / 60)
    assert axle_angle(wheel) == pytest.approx(math.radians(10.0), abs=1e-6)
    wheel.tactile_clay.wheel_speed = 300.0
    wheels.advance(studio.scene, 4 / 60)
    assert apart(axle_angle(wheel), math.radians(130.0)) < 1e-5
    wheels.change_speeds(studio.scene, -150.0)
    wheels.advance(studio.scene, 1 / 60)
    assert apart(axle_angle(wheel), math.radians(145.0)) < 1e-5
    bpy.context.view_layer.update()
    matrix = wheel.matrix_world
    assert apart(math.atan2(matrix[1][0], matrix[0][0]), math.radians(145.0)) < 1e-5
    wheels.end(studio.scene)
    assert apart(angle_at(wheel, 1), math.radians(145.0)) < 1e-5
    assert apart(angle_at(wheel, 2), math.radians(160.0)) < 1e-5


def test_live_wheel_starts_from_rest(studio: Any) -> None:
    """Let a collider become a wheel during a session."""
    wheel = add_wheel(studio)
    wheels = LiveWheels(studio.scene)
    wheels.advance(studio.scene, 1 / 60)
    wheel.tactile_clay.wheel_speed = 60.0
    wheels.advance(studio.scene, 1 / 60)
    assert axle_angle(wheel) == pytest.approx(math.radians(6.0), abs=1e-6)
    wheels.end(studio.scene)
    refresh(studio.scene)
    assert apart(angle_at(wheel, 1), math.radians(6.0)) < 1e-5
