# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking a take again with finer clay, in a separate scene, the film.

The film is a copy of the scene in which the take was recorded, with the same cameras, lights and
settings. In place of the live clay it has clay of a smaller spacing, filled into the surface of the
clay at the take's start, and copies of the hands and tools with the take's keyframes. So sculpting
can continue in the first scene, and both play.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ...solver.geometry.closed_mesh import closed_mesh
from ..base.preferences import missing_parts
from ..base.units import to_meters
from ..clay.look import MODIFIER_NAME, add_look, get_input, set_input
from ..clay.meshes import ClayError, Piece, fill_pieces
from ..core.surface.exact import SurfaceError, reconstruct
from ..core.take.frames import nearest
from ..hands.hand import hand_objects, make_hand, scene_spacing
from ..hands.reading import HandError, hand_armature
from ..hands.store import load_hand, stored_spacing
from ..model.clay_scene import clay_objects, collider_objects
from ..model.collider import TAKE_TOOL
from ..model.material_properties import copy_material
from ..model.point_cloud import make_point_cloud
from ..simulate.edited_clay import prepare_for_edits, room_for, unknown_edit
from .film_scene import copy_scene, drop_objects, film_collection, twins
from .pose import followed
from .store import take_edits, take_start

FINER = 0.5
"""Default spacing of the film's clay, over that of the live clay."""
_SAME_SPACING = 0.01
_TAKE = re.compile(r"_take_\d{3,}$")


class FilmError(TactileClayError):
    """A take cannot be baked again; the message says why and what to do."""


def make_film(
    context: bpy.types.Context, *, spacing: float = 0.0, substeps: int = 0
) -> bpy.types.Scene:
    """Make the film of a scene's take, or bring it up to date.

    Args:
        context: Its scene holds the take, or is the film.
        spacing: Distance between the film's particles [Blender units]; half of the live clay's
            if 0. With the live spacing, the live particles are used as they were.
        substeps: Solver steps in each sixtieth of a second; 0 for the solver's own choice.

    Returns:
        The film's scene, not baked yet. The window still shows the other one.

    Raises:
        FilmError: There is no take, or it cannot be baked again; nothing has changed.
    """
    for sentence in missing_parts():
        raise FilmError(sentence)
    source = context.scene.tactile_clay.film_of or context.scene
    live = [item for item in clay_objects(source) if take_start(item) is not None]
    if not live:
        raise FilmError(
            f"There is no take in the scene {source.name!r}. Switch Record Take on and sculpt, or "
            "press Recover Take to recover one that was cut short."
        )
    edit = unknown_edit(take_edits(source))
    if edit is not None:
        raise FilmError(
            f"The take holds an edit of the kind {edit.kind!r} at {edit.time:.2f} s, which this "
            "version of the add-on does not know. Update the add-on."
        )
    before = min(item.tactile_clay.spacing for item in live)
    spacing = spacing or FINER * before
    pieces = _filled(live, spacing, source)
    known = [scene for scene in bpy.data.scenes if scene.tactile_clay.film_of == source]
    film = known[0] if known else copy_scene(source, f"{source.name} film")
    try:
        with _shown(context, film):
            _furnish(context, film, source, live, pieces, spacing)
    except (FilmError, HandError) as error:
        if not known:
            drop_objects(film)
            bpy.data.scenes.remove(film)
        raise FilmError(str(error)) from error
    properties = film.tactile_clay
    properties.substeps = substeps
    properties.hands_give_way = True
    properties.record_take = False
    if not known:
        base = source.tactile_clay.cache_directory.rstrip("/\\")
        properties.cache_directory = f"{_TAKE.sub('', base)}_film"
    properties.motion_samples = source.tactile_clay.motion_samples
    properties.film_edits = source.tactile_clay.take_edits
    properties.film_of = source
    properties.use_scene_range = True
    film.frame_start, film.frame_end = source.frame_start, source.frame_end
    film.frame_set(film.frame_start)
    return film


def _filled(
    live: list[bpy.types.Object], spacing: float, scene: bpy.types.Scene
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """World positions and colors of the film's particles, for each clay object."""
    # Warp may be missing until this is needed.
    from ...solver.geometry.relax import relax_to_surface

    starts = [take_start(item) for item in live]
    known = [start for start in starts if start is not None]
    own = [item.tactile_clay.spacing for item in live]
    if all(abs(spacing - each) <= 1e-6 * each for each in own):
        return known
    shapes = []
    for item, each, (positions, _) in zip(live, own, known, strict=True):
        try:
            surface = reconstruct(positions, each)
        except (SurfaceError, ImportError) as error:
            raise FilmError(f"{item.name!r} at the start of the take: {error}") from error
        shapes.append(Piece(item.name, closed_mesh(surface.vertices, surface.faces)))
    try:
        points = fill_pieces(shapes, spacing, scene, follow_thin_walls=True).points
    except ClayError as error:
        raise FilmError(f"At the start of the take: {error}") from error
    # The live clay's surface runs through the finer lattice anyhow, which would leave pits.
    even = [
        relax_to_surface(filled, piece.mesh, spacing)
        for filled, piece in zip(points, shapes, strict=True)
    ]
    return [
        (filled, colors[nearest(positions, filled)])
        for filled, (positions, colors) in zip(even, known, strict=True)
    ]


def _furnish(
    context: bpy.types.Context,
    film: bpy.types.Scene,
    source: bpy.types.Scene,
    live: list[bpy.types.Object],
    pieces: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
    spacing: float,
) -> None:
    """Put clay, hands and tools into the film, in place of those it had."""
    drop_objects(film)
    hands = hand_objects(source)
    moving = [
        item
        for name in followed(source).objects
        if (item := source.objects.get(name)) is not None
        and item.animation_data is not None
        and item.animation_data.action is not None
    ]
    moving += [item for item in collider_objects(source) if TAKE_TOOL in item]
    # Armatures that no take moved, too: tracking may move them later.
    moving += [hand_armature(hand) for hand in hands]
    made = twins(source, film, [*moving, *hands], left_out=clay_objects(source))
    edits = take_edits(source)
    room = room_for(edits, to_meters(source, spacing))
    for item, (points, colors) in zip(live, pieces, strict=True):
        # Shown at the place of the first point until they are added.
        points = np.concatenate([points, np.tile(points[:1], (room, 1))])
        colors = np.concatenate([colors, np.tile(colors[:1], (room, 1))])
        clay = _make_clay(context, film, item, points, colors, spacing)
        if edits:
            prepare_for_edits(clay, room)
    context.view_layer.update()
    wanted = to_meters(film, spacing)
    for hand in hands:
        copy = made[hand]
        bound_for = 2.0 * stored_spacing(hand.data)
        if abs(bound_for - wanted) <= _SAME_SPACING * bound_for:
            continue
        # Ghosts are as dense as the clay, so another spacing needs other ghosts.
        side = load_hand(hand.data).rig.side
        copy.data = copy.data.copy()
        make_hand(context, copy, side=side, clay_spacing=scene_spacing(film))


def _make_clay(
    context: bpy.types.Context,
    film: bpy.types.Scene,
    live: bpy.types.Object,
    points: NDArray[np.float32],
    colors: NDArray[np.float32],
    spacing: float,
) -> bpy.types.Object:
    origin = (0.5 * (points.min(0).astype(np.float64) + points.max(0))).astype(np.float32)
    clay = make_point_cloud(context, points - origin, colors, spacing, f"{live.name} (film)")
    for collection in list(clay.users_collection):
        collection.objects.unlink(clay)
    film_collection(film).objects.link(clay)
    clay.location = Vector(origin.tolist())
    properties, before = clay.tactile_clay, live.tactile_clay
    properties.role = "CLAY"
    properties.spacing = spacing
    properties.material_preset = before.material_preset
    copy_material(before, properties)
    for material in live.data.materials:
        clay.data.materials.append(material)
    modifier = add_look(clay, spacing=spacing)
    shown = live.modifiers.get(MODIFIER_NAME)
    # What was baked for a film is looked at as a surface, however many particles it has.
    set_input(modifier, "Viewport Limit", max(get_input(modifier, "Viewport Limit"), len(points)))
    for name in ("Surface", "Smoothing", "Material"):
        if shown is not None and shown.node_group == modifier.node_group:
            set_input(modifier, name, get_input(shown, name))
    return clay


@contextmanager
def _shown(context: bpy.types.Context, scene: bpy.types.Scene) -> Iterator[None]:
    """Work in a scene, then return to the one before."""
    if context.window is None:
        with context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            yield
        return
    before = context.window.scene
    context.window.scene = scene
    try:
        yield
    finally:
        context.window.scene = before
