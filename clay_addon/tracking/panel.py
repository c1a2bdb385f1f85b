# SPDX-License-Identifier: GPL-3.0-or-later
"""The *Tracking* panel in the Clay tab."""

from __future__ import annotations

import bpy

from ..base.preferences import draw_text
from ..core.tracking.protocol.joints import SIDES
from . import live

_STATE_ICONS = {"live": "CHECKMARK", "held": "PAUSE", "lost": "X"}


class CLAY_PT_tracking(bpy.types.Panel):  # noqa: N801
    """Settings and status of hand tracking."""

    bl_label = "Tracking"
    bl_order = 4
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Clay"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        properties = context.scene.tactile_clay_tracking
        session = live.tracking.session
        column = layout.column()
        column.prop(properties, "left")
        column.prop(properties, "right")
        column.prop(properties, "origin")
        if session is None:
            column.prop(properties, "source")
            if properties.source == "RECORDING":
                column.prop(properties, "recording")
            column.prop(properties, "port")
            layout.operator("clay.tracking_start", icon="VIEW_PAN")
        else:
            layout.operator("clay.tracking_stop", icon="CANCEL")
            _draw_status(layout, session)
            recorder = session.recorder
            row = layout.row()
            row.alert = recorder is not None
            row.operator(
                "clay.tracking_record",
                text="Record" if recorder is None else f"Stop Recording ({recorder.count} frames)",
                icon="RADIOBUT_OFF" if recorder is None else "RADIOBUT_ON",
            )
        layout.prop(properties, "recording_folder")
        layout.operator("clay.tracking_import", icon="IMPORT")


def _draw_status(layout: bpy.types.UILayout, session: live.LiveTracking) -> None:
    box = layout.box()
    receiver = session.receiver
    sender = session.sender
    if sender is not None and not sender.runs:
        draw_text(box, sender.problem or "The sender has exited.", icon="ERROR")
    if not receiver.accepted:
        text = f"No hands have arrived at port {receiver.address[1]} yet."
        if sender is None:
            text += " Choose a source, or start a sender in a terminal: tactile-clay track leap"
        draw_text(box, text, icon="INFO")
    else:
        box.label(text=f"Source: {receiver.source}", icon="LIGHTPROBE_VOLUME")
    for side in SIDES:
        for text, icon in status(session, side):
            box.label(text=text, icon=icon)
    if receiver.rejected:
        reason, count = receiver.reasons.most_common(1)[0]
        text = f"Rejected datagrams: {receiver.rejected} ({count} × {reason})"
        draw_text(box, text, icon="ERROR")
    if session.problem:
        draw_text(box, session.problem, icon="ERROR")


def status(session: live.LiveTracking, side: str) -> list[tuple[str, str]]:
    """Status lines of a hand with their icons; empty before it is first seen."""
    hand = session.hand(side)
    if hand is None:
        return []
    text = f"{side.capitalize()}: {hand.state}"
    if hand.state == "live":
        text += f", {session.receiver.rate(side):.0f} frames/s"
        latency = session.receiver.latency(side)
        if latency is not None:
            text += f", {latency * 1e3:.0f} ms"
        if hand.contact < 1.0:
            text += f", contact {hand.contact:.0%}"
    return [(text, _STATE_ICONS[hand.state])]


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(CLAY_PT_tracking)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(CLAY_PT_tracking)
