# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking a take again with finer clay, in a separate scene called the film.

The film is a copy of the scene in which the take was recorded, with the same cameras, lights and
settings. In place of the live clay it has clay with a smaller spacing, which fills the surface of
the clay at the start of the take, and copies of the hands and tools with the take's keyframes. This
allows sculpting to continue in the original scene, and both scenes to play.
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
from ..simulate.edited_clay import prepare_for_edits, spare_particle_count, unknown_edit
from .film_scene import copy_objects, copy_scene, film_collection, remove_film_objects
from .pose import recorded_layout
from .store import take_edits, take_start

DEFAULT_SPACING_RATIO = 0.5
"""Default ratio of the film's particle spacing to that of the live clay."""
_SPACING_TOLERANCE = 0.01
_TAKE = re.compile(r"_take_\d{3,}$")


class FilmError(TactileClayError):
    """A take cannot be baked again; the message says why and what to do."""


def make_film(
    context: bpy.types.Context, *, spacing: float = 0.0, substeps: int = 0
) -> bpy.types.Scene:
    """Make or update the film of a scene's take.

    Args:
        context: Its scene holds the take, or is the film.
        spacing: Particle spacing of the film [Blender units]; 0 for half of the live spacing. With
            the live spacing, the film gets the same particles as the live clay.
        substeps: Solver steps per sixtieth of a second; 0 lets the solver choose.

    Returns:
        The film scene, not baked yet. The window still shows the previous scene.

    Raises:
        FilmError: There is no take, or it cannot be baked again; nothing has changed.
    """
    for sentence in missing_parts():
        raise FilmError(sentence)
    source = context.scene.tactile_clay.film_of or context.scene
    live = [item for item in clay_objects(source) if take_start(item) is not None]
    if not live:
        raise FilmError(
            f"There is no take in the scene {source.name!r}. Switch on Record Take and sculpt, or "
            "press Recover Take to recover an interrupted take."
        )
    edit = unknown_edit(take_edits(source))
    if edit is not None:
        raise FilmError(
            f"The take contains an edit of the kind {edit.kind!r} at {edit.time:.2f} s, which this "
            "version of the add-on does not support. Update the add-on."
        )
    live_spacing = min(item.tactile_clay.spacing for item in live)
    spacing = spacing or DEFAULT_SPACING_RATIO * live_spacing
    pieces = _fill_clay(live, spacing, source)
    existing = [scene for scene in bpy.data.scenes if scene.tactile_clay.film_of == source]
    film = existing[0] if existing else copy_scene(source, f"{source.name} film")
    try:
        with _active_scene(context, film):
            _populate(context, film, source, live, pieces, spacing)
    except (FilmError, HandError) as error:
        if not existing:
            remove_film_objects(film)
            bpy.data.scenes.remove(film)
        raise FilmError(str(error)) from error
    properties = film.tactile_clay
    properties.substeps = substeps
    properties.hands_give_way = True
    properties.record_take = False
    if not existing:
        base = source.tactile_clay.cache_directory.rstrip("/\\")
        properties.cache_directory = f"{_TAKE.sub('', base)}_film"
    properties.motion_samples = source.tactile_clay.motion_samples
    properties.film_edits = source.tactile_clay.take_edits
    properties.film_of = source
    properties.use_scene_range = True
    film.frame_start, film.frame_end = source.frame_start, source.frame_end
    film.frame_set(film.frame_start)
    return film


def _fill_clay(
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
    for item, live_spacing, (positions, _) in zip(live, own, known, strict=True):
        try:
            surface = reconstruct(positions, live_spacing)
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


def _populate(
    context: bpy.types.Context,
    film: bpy.types.Scene,
    source: bpy.types.Scene,
    live: list[bpy.types.Object],
    pieces: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
    spacing: float,
) -> None:
    """Put clay, hands and tools into the film, replacing earlier ones."""
    remove_film_objects(film)
    hands = hand_objects(source)
    moving = [
        item
        for name in recorded_layout(source).objects
        if (item := source.objects.get(name)) is not None
        and item.animation_data is not None
        and item.animation_data.action is not None
    ]
    moving += [item for item in collider_objects(source) if TAKE_TOOL in item]
    # Include armatures that did not move in the take: tracking may move them later.
    moving += [hand_armature(hand) for hand in hands]
    copies = copy_objects(source, film, [*moving, *hands], excluded=clay_objects(source))
    edits = take_edits(source)
    spare_count = spare_particle_count(edits, to_meters(source, spacing))
    for item, (points, colors) in zip(live, pieces, strict=True):
        # Spare particles are shown at the position of the first one until they are added.
        points = np.concatenate([points, np.tile(points[:1], (spare_count, 1))])
        colors = np.concatenate([colors, np.tile(colors[:1], (spare_count, 1))])
        clay = _make_clay(context, film, item, points, colors, spacing)
        if edits:
            prepare_for_edits(clay, spare_count)
    context.view_layer.update()
    film_spacing = to_meters(film, spacing)
    for hand in hands:
        copy = copies[hand]
        hand_spacing = 2.0 * stored_spacing(hand.data)
        if abs(hand_spacing - film_spacing) <= _SPACING_TOLERANCE * hand_spacing:
            continue
        # Ghost particles are as dense as the clay, so a different spacing needs new ones.
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
    properties, live_properties = clay.tactile_clay, live.tactile_clay
    properties.role = "CLAY"
    properties.spacing = spacing
    properties.material_preset = live_properties.material_preset
    copy_material(live_properties, properties)
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
def _active_scene(context: bpy.types.Context, scene: bpy.types.Scene) -> Iterator[None]:
    """Make a scene the active one, then return to the previous scene."""
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
