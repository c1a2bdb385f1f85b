# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene holds and what is baked of it, as plain data and as text."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Any

import bpy

from ..bake.checks import compare
from ..base.preferences import ADDON_VERSION, missing_parts
from ..base.units import to_meters
from ..core.readable import size_text
from ..core.storage.cache import Cache, CacheError
from ..hands.hand import hand_message, hand_objects, read_hand_rig
from ..hands.reading import HandError
from ..model.cache_folder import CacheFolderError, resolve_directory
from ..model.clay_scene import (
    SimulationError,
    clay_objects,
    collider_objects,
    frames_per_second,
    material_of,
)
from ..model.collider import ColliderError, resolve_kind
from ..model.properties import frame_range
from ..playback.playback import paused
from ..simulate.simulation import Simulation


def scene_status(
    context: bpy.types.Context, directory: str | os.PathLike[str] | None = None
) -> dict[str, Any]:
    """Describe the clay, the colliders, the hands and the bake of a scene; needs no solver.

    Args:
        context: Its scene is described; its current frame is the same afterwards.
        directory: Cache folder; the scene's setting where not given.
    """
    scene = context.scene
    # Reading a hand changes the scene for a moment, so what is evaluated is looked at after it.
    hands = [_describe_hand(context, item) for item in hand_objects(scene)]
    depsgraph = context.evaluated_depsgraph_get()
    return {
        "file": bpy.data.filepath,
        "scene": scene.name,
        "version": ADDON_VERSION,
        "frames_per_second": frames_per_second(scene),
        "clay": [
            {
                "name": item.name,
                "particle_count": len(item.data.points),
                "spacing": to_meters(scene, item.tactile_clay.spacing),
                "preset": item.tactile_clay.material_preset,
                "material": asdict(material_of(item)),
            }
            for item in clay_objects(scene)
        ],
        "colliders": [_describe_collider(item, depsgraph) for item in collider_objects(scene)],
        "hands": hands,
        "bake": _describe_bake(context, directory),
        "problems": missing_parts(),
    }


def _describe_collider(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    properties = item.tactile_clay
    table = {"name": item.name, "friction": properties.collider_friction, "problem": ""}
    try:
        kind = resolve_kind(item, properties.collider_kind, depsgraph)
        return {**table, "kind": kind.lower()}
    except ColliderError as error:
        return {**table, "kind": None, "problem": str(error)}


def _describe_hand(context: bpy.types.Context, item: bpy.types.Object) -> dict[str, Any]:
    table: dict[str, Any] = {
        "name": item.name,
        "side": None,
        "ghost_count": 0,
        "friction": item.tactile_clay.collider_friction,
        "problem": "",
    }
    try:
        rig = read_hand_rig(context, item)
    except HandError as error:
        return {**table, "problem": str(error)}
    return {
        **table,
        "side": rig.side or None,
        "ghost_count": len(rig.ghost_areas),
        "problem": hand_message(context.scene, item),
    }


def _describe_bake(
    context: bpy.types.Context, directory: str | os.PathLike[str] | None
) -> dict[str, Any]:
    scene = context.scene
    start, end = frame_range(scene)
    table: dict[str, Any] = {
        "directory": None,
        "range": [start, end],
        "frames": 0,
        "missing": [],
        "stale": "",
        "problem": "",
        "size": 0,
        "statistics": {},
    }
    try:
        cache = Cache(resolve_directory(scene, directory))
    except CacheFolderError as error:
        # Not a fault yet: nobody has asked for a bake.
        return {**table, "directory_problem": str(error)}
    table["directory"] = str(cache.directory)
    if not cache.exists():
        return table
    previous = scene.frame_current, scene.frame_subframe
    try:
        meta = cache.meta()
        whole = cache.intact_frames(meta.start, meta.end)
        table["range"] = [meta.start, meta.end]
        table["frames"] = len(whole)
        table["missing"] = [n for n in range(meta.start, meta.end + 1) if n not in whole]
        table["size"] = cache.size()
        table["statistics"] = dict(meta.statistics)
        with paused():
            scene.frame_set(meta.start)
            simulation = Simulation(context)
            table["stale"] = compare(scene, simulation, cache, simulation.digests())
    except (CacheError, SimulationError) as error:
        table["problem"] = str(error)
    finally:
        scene.frame_set(previous[0], subframe=previous[1])
    return table


def status_text(table: dict[str, Any]) -> str:
    """The table of `scene_status` as text."""
    lines = [f"{table['file'] or 'unsaved file'}, scene {table['scene']}"]
    for clay in table["clay"]:
        lines.append(
            f"  clay      {clay['name']}: {clay['particle_count']:,} particles "
            f"{clay['spacing'] * 1e3:.3g} mm apart, {clay['preset'].replace('_', ' ').lower()}"
        )
    if not table["clay"]:
        lines.append("  no clay")
    for collider in table["colliders"]:
        what = collider["problem"] or f"{collider['kind']}, friction {collider['friction']:.2g}"
        lines.append(f"  collider  {collider['name']}: {what}")
    for hand in table["hands"]:
        what = hand["problem"] or (
            f"{hand['side'] or 'side unknown'}, {hand['ghost_count']:,} ghosts, "
            f"friction {hand['friction']:.2g}"
        )
        lines.append(f"  hand      {hand['name']}: {what}")
    bake = table["bake"]
    start, end = bake["range"]
    if not bake["frames"] and not bake["problem"]:
        lines.append(f"  bake      none of frames {start} to {end}")
    else:
        lines.append(
            f"  bake      {bake['frames']} of {end + 1 - start} frames ({start} to {end}), "
            f"{size_text(bake['size'])} in {bake['directory']}"
        )
    if bake["missing"] and bake["frames"]:
        lines.append(f"  missing   from frame {bake['missing'][0]}: resume the bake")
    if bake["stale"]:
        lines.append(f"  stale     {bake['stale']}: bake again")
    lines += [f"  problem   {text}" for text in (bake["problem"], *table["problems"]) if text]
    return "\n".join(lines)
