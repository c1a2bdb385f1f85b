# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch in a real Blender: its own Python starts the array server, with what the zip brought."""

from typing import Any

FEEL = """
import time
import bpy
import numpy as np

bpy.ops.preferences.addon_enable(module="bl_ext.user_default.tactile_clay")
from bl_ext.user_default.tactile_clay.clay_addon.touch.connection import touch
from bl_ext.user_default.tactile_clay.haptics import Foci
from bl_ext.user_default.tactile_clay.haptics.foci.pipeline import TouchFrame

scene = bpy.context.scene
bpy.ops.clay.array_add(preset="openmpd")
print("CONNECT", bpy.ops.clay.touch_connect())
foci = Foci(np.array(((0.0, 0.0, 0.2),)), np.array((500.0,)), np.zeros(0, int), 0.00865)
frame = TouchFrame(foci)
end = time.monotonic() + 30.0
while time.monotonic() < end and not (touch.status and touch.status.foci):
    touch.send(scene, frame)
    time.sleep(1 / 60)
print("FELT", touch.status.foci, touch.status.device)
process = touch.client.process
bpy.ops.clay.touch_disconnect()
print("ENDED", process.returncode)

# The server finds pyserial, and says what it lacks otherwise.
scene.tactile_touch.kind = "SONICSURFACE"
scene.tactile_touch.port = "/dev/no-such-port"
bpy.ops.clay.touch_connect()
while time.monotonic() < end and not (touch.status and touch.status.fault):
    touch.client.hello()
    touch.read_status(wait=0.2)
print("FAULT", touch.status.fault)
"""


def test_the_array_server_runs_with_blenders_python(blender_with_extension: Any) -> None:
    """Connect to a simulated array, feel a focal point, end; and open serial ports."""
    result = blender_with_extension.run_script(FEEL)
    assert result.exit_code == 0, result.output
    assert "CONNECT {'FINISHED'}" in result.output
    assert "FELT 1 simulated:openmpd" in result.output
    assert "ENDED 0" in result.output
    assert "FAULT /dev/no-such-port cannot be opened" in result.output
