# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands tracked in a real Blender with a window: timer, panel, and a sender in another Blender."""

from typing import Any

from tactile_clay.clay_addon.core.tracking.recording.recording import Recorder
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at

TRACK = """
import os
import subprocess
import sys

import bpy
from mathutils import Matrix

PACKAGE = "bl_ext.user_default.tactile_clay"
from bl_ext.user_default.tactile_clay.clay_addon.tracking import live, panel
from bl_ext.user_default.tactile_clay.clay_addon.core.tracking.protocol.joints import (
    PARENTS, reference_hand
)
from bl_ext.user_default.tactile_clay.clay_addon.core.tracking.hand.retarget import Z_UP
from bl_ext.user_default.tactile_clay.clay_addon.core.tracking.protocol.joints import JOINT_NAMES

recording = sys.argv[sys.argv.index("--") + 1]
drawn = []
draw = panel.CLAY_PT_tracking.draw

def draw_and_record(self, context):
    draw(self, context)
    drawn.append(live.running.session is not None)

panel.CLAY_PT_tracking.draw = draw_and_record

def add_hand():
    data = bpy.data.armatures.new("Hand.R")
    item = bpy.data.objects.new("Hand.R", data)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    rest = reference_hand("right")
    for name, place, turn in zip(JOINT_NAMES, rest.positions, rest.rotations):
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = (0.0, 0.0, 0.0), (0.0, 0.01, 0.0)
        matrix = Matrix(Z_UP @ turn).to_4x4()
        matrix.translation = Z_UP @ place
        bone.matrix = matrix
    bpy.ops.object.mode_set(mode="OBJECT")
    return item

def view():
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window, area=area, region=region)

places = []

def begin():
    with view():
        add_hand()
        properties = bpy.context.scene.tactile_clay_tracking
        properties.source, properties.recording = "RECORDING", recording
        print("START", bpy.ops.clay.tracking_start(), flush=True)
    bpy.app.timers.register(look, first_interval=0.2)

def look():
    session = live.running.session
    if session is None:
        print("ENDED BY ITSELF", flush=True)
        bpy.ops.wm.quit_blender()
        return None
    if not session.sender.runs:
        print("SENDER FAILED", session.sender.problem, flush=True)
        bpy.ops.wm.quit_blender()
        return None
    hand = session.hand("right")
    if hand is None or hand.contact < 1.0:
        return 0.2
    item = bpy.data.objects["Hand.R"]
    places.append(tuple(item.pose.bones["wrist"].matrix.translation))
    if len(places) < 4:
        return 0.2
    with view():
        bpy.ops.wm.call_panel(name="CLAY_PT_tracking")
        bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)
    print("STATE", hand.state, "contact", round(item["clay_contact"], 2))
    print("MOVED", len(set(places)) > 1, "DRAWN", True in drawn)
    print("SOURCE", session.receiver.source, "REJECTED", session.receiver.rejected)
    print("STOP", bpy.ops.clay.tracking_stop(), "SENDER RUNS", session.sender.runs, flush=True)
    bpy.ops.wm.quit_blender()

bpy.app.timers.register(begin, first_interval=0.5)
"""


def test_hand_follows_a_sender_in_another_blender(blender_with_extension: Any) -> None:
    """Start tracking from the panel, see the hand move by Blender's own timer, and stop."""
    path = blender_with_extension.folder / "take.jsonl"
    recorder = Recorder(path)
    for number in range(400):
        at = (0.1 + 1e-4 * (number % 100), 0.2, 0.0)
        recorder.take(frame_at(number, number, at=at), number * 10 * MILLISECOND)
    recorder.close()
    result = blender_with_extension.run_script(TRACK, path, window=True, timeout=180)
    assert "Traceback" not in result.output, result.output
    assert "START {'FINISHED'}" in result.output
    assert "STATE live contact 1.0" in result.output, result.output
    assert "MOVED True DRAWN True" in result.output
    assert "SOURCE leap REJECTED 0" in result.output
    assert "STOP {'FINISHED'} SENDER RUNS False" in result.output
