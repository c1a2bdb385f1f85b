# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of clay during a live session: a mesh object displayed in place of the clay.

This stand-in is never saved, and is removed when a file is loaded or something is undone; the clay
is then displayed as before.
"""

from __future__ import annotations

import json
import time
import weakref
from collections.abc import Sequence

import bpy
from bpy.app.handlers import persistent

from ...base.app_handlers import add_handlers, remove_handlers
from ...base.later import later
from ...base.surface_mesh import fill_surface_mesh
from ...clay.look import MODIFIER_NAME
from ...clay.look_material import clay_material
from ...core.surface.worker import Part, SurfaceWorker
from ...playback.poses import pose_modifier

OBJECT_NAME = "Live clay"
MAX_SECONDS = 0.2
"""A surface that takes longer than this is too slow to follow hands [s]."""
_MARK = "tactile_clay_live_surface"
"""Custom property of the stand-in."""
_BEFORE = "tactile_clay_before_live"
"""Custom property of clay replaced by a stand-in: how it was displayed before."""
_POINTS = object()
"""Value of `_shown` while points are displayed instead of a surface."""

_open: weakref.WeakSet[LiveSurface] = weakref.WeakSet()


class LiveSurface:
    """Displays the clay of a live session as one smooth, colored surface. For the main thread.

        live = LiveSurface(context, clay_objects(context.scene))
        live.offer([(positions, colors)])  # each tick
        live.show()                        # each tick
        live.close()

    The clay objects are hidden in the viewport but still evaluated, without their own surface,
    which takes far longer; renders show them as usual. If surfaces cannot keep pace, points are
    shown while the clay moves, and the surface once it is still.

    Args:
        context: Context with the scene.
        clay_objects: Clay of one spacing. The surface gets the material of the first one.

    Raises:
        ValueError: There is no clay.
        SurfaceError: The spacing of the clay is not a positive length.
    """

    def __init__(
        self, context: bpy.types.Context, clay_objects: Sequence[bpy.types.Object]
    ) -> None:
        if not clay_objects:
            raise ValueError("There is no clay to show.")
        from ...core.surface.quick.surface import QuickSurface, load_kernels

        self.spacing = clay_objects[0].tactile_clay.spacing
        quick = QuickSurface(self.spacing)
        load_kernels()
        # Undo replaces objects with new ones that have the same identifiers.
        self._scene_id = context.scene.session_uid
        self._clay_ids = [item.session_uid for item in clay_objects]
        sweep(context.scene)
        self._worker: SurfaceWorker | None = SurfaceWorker(quick)
        self._shown: object = None
        self._writing_seconds = 0.0
        _open.add(self)

    @property
    def problem(self) -> str:
        """Why there is no surface; empty if there is one or none was requested."""
        return self._worker.finished().problem if self._worker else ""

    @property
    def seconds(self) -> float:
        """Approximate time that a surface takes on its thread [s]; 0 before the first."""
        return self._worker.seconds if self._worker else 0.0

    @property
    def keeps_pace(self) -> bool:
        """Whether surfaces are fast enough to show the clay while it moves."""
        return self.seconds + self._writing_seconds <= MAX_SECONDS

    def offer(self, parts: Sequence[Part]) -> None:
        """Request a surface of the clay as it is now; never waits.

        Args:
            parts: World positions [Blender units], shape [N, 3], and linear RGBA, shape [N, 4], of
                each clay object. They are copied.
        """
        if self._worker:
            self._worker.offer(parts)

    def show(self) -> bool:
        """Show the latest finished surface; returns whether the display has changed."""
        if self._worker is None or self._scene() is None:
            return False
        finished = self._worker.finished()
        surface = finished.surface
        if surface is None:
            return bool(finished.problem) and self._show_points()
        if surface is self._shown:
            return False
        if not (self.keeps_pace or finished.settled):
            return self._show_points()
        began = time.perf_counter()
        item = self._object()
        fill_surface_mesh(
            item.data,
            surface.vertices,
            surface.faces,
            spacing=self.spacing,
            colors=surface.colors,
            edges=surface.edges,
            face_edges=surface.face_edges,
        )
        self._writing_seconds = time.perf_counter() - began
        self._switch(to_surface=True)
        self._shown = surface
        return True

    def leave(self) -> None:
        """Show the clay itself until the next surface is ready."""
        sweep(self._scene())
        self._shown = None

    def close(self) -> None:
        """End the thread, and display the clay as before. A second call does nothing."""
        worker, self._worker = self._worker, None
        if worker is None:
            return
        _open.discard(self)
        worker.end()
        self.leave()

    def _show_points(self) -> bool:
        """Show the clay's points instead of a surface; returns whether the display has changed."""
        changed = self._shown is not _POINTS
        if changed:
            self._switch(to_surface=False)
            self._shown = _POINTS
        return changed

    def _switch(self, *, to_surface: bool) -> None:
        scene = self._scene()
        for item in _marked(scene):
            _hide(item, scene, not to_surface)
        for clay in self._clay():
            _remember_display(clay, scene)
            _hide(clay, scene, to_surface)

    def _scene(self) -> bpy.types.Scene | None:
        found = (scene for scene in bpy.data.scenes if scene.session_uid == self._scene_id)
        return next(found, None)

    def _clay(self) -> list[bpy.types.Object]:
        scene = self._scene()
        own = {item.session_uid: item for item in scene.objects} if scene else {}
        return [own[identifier] for identifier in self._clay_ids if identifier in own]

    def _object(self) -> bpy.types.Object:
        """The stand-in; created if there is none."""
        scene = self._scene()
        assert scene is not None
        for item in _marked(scene):
            return item
        mesh = bpy.data.meshes.new(OBJECT_NAME)
        clay = self._clay()
        own = clay[0].active_material if clay else None
        mesh.materials.append(own or clay_material())
        item = bpy.data.objects.new(OBJECT_NAME, mesh)
        item[_MARK] = True
        item.hide_render = item.hide_select = True
        scene.collection.objects.link(item)
        return item


def sweep(scene: bpy.types.Scene | None) -> None:
    """Remove the stand-in from a scene, and display the clay as before."""
    if scene is None:
        return
    for item in _marked(scene):
        mesh = item.data
        bpy.data.objects.remove(item)
        if mesh is not None and not mesh.users:
            bpy.data.meshes.remove(mesh)
    for clay in scene.objects:
        if _BEFORE in clay:
            before = json.loads(clay[_BEFORE])
            del clay[_BEFORE]
            modifier = clay.modifiers.get(MODIFIER_NAME)
            if modifier is not None:
                modifier.show_viewport = before["surface"]
            keyed = pose_modifier(clay)
            if keyed is not None:
                keyed.show_viewport = before["poses"]
            for name in before["seen"]:
                layer = scene.view_layers.get(name)
                if layer and clay.name in layer.objects:
                    clay.hide_set(False, view_layer=layer)
                    clay.select_set(name in before["selected"], view_layer=layer)


def _remember_display(clay: bpy.types.Object, scene: bpy.types.Scene | None) -> None:
    """Record once how clay is displayed, and disable its own surface in the viewport."""
    if _BEFORE in clay or scene is None:
        return
    modifier = clay.modifiers.get(MODIFIER_NAME)
    layers = [layer for layer in scene.view_layers if clay.name in layer.objects]
    keyed = pose_modifier(clay)
    before = {
        "surface": modifier is not None and modifier.show_viewport,
        "poses": keyed is not None and keyed.show_viewport,
        "seen": [layer.name for layer in layers if not clay.hide_get(view_layer=layer)],
        "selected": [layer.name for layer in layers if clay.select_get(view_layer=layer)],
    }
    clay[_BEFORE] = json.dumps(before)
    for each in (modifier, keyed):
        if each is not None:
            each.show_viewport = False


def _hide(item: bpy.types.Object, scene: bpy.types.Scene | None, hidden: bool) -> None:
    """Hide or show an object in the viewport, in all view layers; it is evaluated either way."""
    for layer in scene.view_layers if scene else ():
        if item.name in layer.objects and item.hide_get(view_layer=layer) != hidden:
            item.hide_set(hidden, view_layer=layer)


def _marked(scene: bpy.types.Scene | None) -> list[bpy.types.Object]:
    return [] if scene is None else [item for item in scene.objects if _MARK in item]


def _reload() -> None:
    """Remove stand-ins restored from a file or an undo step, and show live surfaces again."""
    for live in list(_open):
        if live._scene() is None:
            live.close()
        else:
            live.leave()
            live.show()
    for scene in bpy.data.scenes:
        if scene.session_uid not in {live._scene_id for live in _open}:
            sweep(scene)


def _leave_file() -> None:
    # The session's scene is gone, even if the new file has a scene of the same name.
    for live in list(_open):
        live.close()
    _reload()


@persistent
def _on_reload(*_: object) -> None:
    later.schedule(_reload)


@persistent
def _on_load(*_: object) -> None:
    later.schedule(_leave_file)


@persistent
def _before_save(*_: object) -> None:
    for live in _open:
        live.leave()


@persistent
def _after_save(*_: object) -> None:
    for live in _open:
        live.show()


_HANDLERS = (
    ("load_post", _on_load),
    ("undo_post", _on_reload),
    ("redo_post", _on_reload),
    ("save_pre", _before_save),
    ("save_post", _after_save),
    ("save_post_fail", _after_save),
)


def register() -> None:
    """Add the handlers."""
    add_handlers(_HANDLERS)


def unregister() -> None:
    """Close all live surfaces, and remove the handlers."""
    for live in list(_open):
        live.close()
    remove_handlers(_HANDLERS)
