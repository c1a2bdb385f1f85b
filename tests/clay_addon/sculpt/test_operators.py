# SPDX-License-Identifier: GPL-3.0-or-later
"""Events that the Sculpt operator handles itself."""

from typing import Any

import pytest

from tactile_clay.clay_addon.sculpt.operators import opens_tool_menu
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import Event, Mouse


@pytest.mark.parametrize(
    ("values", "opens"),
    [
        ({"shift": True}, True),
        ({"shift": False}, False),
        ({"shift": True, "value": "RELEASE"}, False),
    ],
)
def test_shift_space_opens_the_menu_of_tools(mouse: Mouse, values: Any, opens: bool) -> None:
    """Open it only over a 3D view, and leave the event to the brush during a stroke."""
    event = Event("SPACE", **values)
    assert not opens_tool_menu(event, mouse.brush)
    mouse.move(0.0, 0.0)
    assert not mouse.send("SPACE", **values)
    assert opens_tool_menu(event, mouse.brush) == opens
    mouse.press()
    assert mouse.send("SPACE", **values)
