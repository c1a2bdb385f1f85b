# SPDX-License-Identifier: GPL-3.0-or-later
"""Description of a scene and its bake, as plain data and as text."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Any

import bpy

from ..bake.checks import compare
from ..base.clock import go_to, shown_moment
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
    """Describe clay, colliders, hands and bake of a scene without starting a solver.

    Args:
        context: Its scene is described; the current frame is restored afterward.
        directory: Cache folder; by default from the scene's settings.
    """
    scene = context.scene
    # Reading a hand temporarily changes the scene, so this precedes its evaluation.
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
        # Not an error, as long as no bake is requested.
        return {**table, "directory_problem": str(error)}
    table["directory"] = str(cache.directory)
    if not cache.exists():
        return table
    previous = shown_moment(scene)
    try:
        meta = cache.meta()
        intact = cache.intact_frames(meta.start, meta.end)
        table["range"] = [meta.start, meta.end]
        table["frames"] = len(intact)
        table["missing"] = [n for n in range(meta.start, meta.end + 1) if n not in intact]
        table["size"] = cache.size()
        table["statistics"] = dict(meta.statistics)
        with paused():
            scene.frame_set(meta.start)
            simulation = Simulation(context)
            table["stale"] = compare(scene, simulation, cache, simulation.digests())
    except (CacheError, SimulationError) as error:
        table["problem"] = str(error)
    finally:
        go_to(scene, previous)
    return table


def status_text(table: dict[str, Any]) -> str:
    """Format the table of `scene_status` as text."""
    lines = [f"{table['file'] or 'unsaved file'}, scene {table['scene']}"]
    for clay in table["clay"]:
        lines.append(
            f"  clay      {clay['name']}: {clay['particle_count']:,} particles "
            f"with {clay['spacing'] * 1e3:.3g} mm spacing, "
            f"{clay['preset'].replace('_', ' ').lower()}"
        )
    if not table["clay"]:
        lines.append("  no clay")
    for collider in table["colliders"]:
        text = collider["problem"] or f"{collider['kind']}, friction {collider['friction']:.2g}"
        lines.append(f"  collider  {collider['name']}: {text}")
    for hand in table["hands"]:
        text = hand["problem"] or (
            f"{hand['side'] or 'side unknown'}, {hand['ghost_count']:,} ghosts, "
            f"friction {hand['friction']:.2g}"
        )
        lines.append(f"  hand      {hand['name']}: {text}")
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
