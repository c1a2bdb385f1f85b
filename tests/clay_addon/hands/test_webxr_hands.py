# SPDX-License-Identifier: GPL-3.0-or-later
"""The generic hands of WebXR as foreign hands, imported by Blender's glTF importer.

They come from the npm package @webxr-input-profiles/assets, which is fetched once into build/.
"""

import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from tactile_clay.clay_addon.hands.hand import hand_bone_matrices, make_hand, read_hand_rig
from tactile_clay.solver.geometry.lattice_tetrahedra import tetrahedron_volumes
from tactile_clay.solver.hand.parts import hand_parts
from tactile_clay.solver.hand.rig import HandRig

PACKAGE = "@webxr-input-profiles/assets@1.0.20"
FOLDER = Path(__file__).parents[3] / "build" / "webxr-hands"
INSIDE = "package/dist/profiles/generic-hand"
FETCH_SECONDS = 120


def fetch() -> str:
    """Fetch both hands into the folder.

    Returns:
        Why the hands are unavailable; empty if they are available.
    """
    if all((FOLDER / f"{side}.glb").exists() for side in ("left", "right")):
        return ""
    npm = shutil.which("npm")
    if npm is None:
        return "there is no npm"
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=FOLDER) as folder:
        command = [
            npm,
            "pack",
            PACKAGE,
            "--silent",
            "--fetch-retries=0",
            f"--pack-destination={folder}",
        ]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=FETCH_SECONDS)
        except (subprocess.SubprocessError, OSError) as error:
            return f"{PACKAGE} cannot be fetched ({error})"
        (archive,) = Path(folder).glob("*.tgz")
        with tarfile.open(archive) as package:
            for side in ("left", "right"):
                source = package.extractfile(f"{INSIDE}/{side}.glb")
                assert source is not None
                partial = Path(folder) / f"{side}.glb"
                partial.write_bytes(source.read())
                partial.replace(FOLDER / f"{side}.glb")
    return ""


@pytest.fixture(scope="module")
def folder() -> Path:
    reason = fetch()
    if reason:
        pytest.skip(f"the generic hands are not available: {reason}")
    return FOLDER


@pytest.fixture(params=["left", "right"])
def hand(request: pytest.FixtureRequest, studio: Any, folder: Path) -> Any:
    """One of the hands, imported and bound."""
    bpy.ops.import_scene.gltf(filepath=str(folder / f"{request.param}.glb"))
    (item,) = (item for item in bpy.data.objects if item.name.endswith("handMeshNode"))
    make_hand(bpy.context, item, clay_spacing=0.01)
    return item


def curl(item: Any, angle: float) -> None:
    """Bend all fingers: each joint rotates all bones beyond it, which have no parents here."""
    armature = item.parent
    rest = {bone.name: np.array(bone.matrix_local) for bone in armature.data.bones}
    posed = {name: matrix.copy() for name, matrix in rest.items()}
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        parent = "wrist"
        for segment in ("metacarpal", "proximal", "intermediate", "distal", "tip"):
            found = [name for name in rest if finger in name and segment in name]
            for name in found:
                local = np.linalg.inv(rest[parent]) @ rest[name]
                bends = segment in ("proximal", "intermediate", "distal") and finger != "thumb"
                posed[name] = posed[parent] @ local @ (turn if bends else np.eye(4))
                parent = name
    for bone in armature.pose.bones:
        bone.matrix = Matrix(posed[bone.name].tolist())
    bpy.context.view_layer.update()


def shown_vertices(item: Any, rig: HandRig, rest: np.ndarray) -> np.ndarray:
    """Blender's position of each vertex of the rig's skin [m], shape [V, 3]."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.array([vertex.co for vertex in evaluated.data.vertices])
    matrix = np.array(evaluated.matrix_world)
    points = points @ matrix[:3, :3].T + matrix[:3, 3]
    # Seams are welded in the rig, so any vertex with the same rest position will do.
    nearest = [np.linalg.norm(rest - vertex, axis=1).argmin() for vertex in rig.vertices]
    return points[nearest]


def test_hand_is_bound_with_its_seams_welded(hand: Any) -> None:
    """Find one closed skin of 1159 vertices, and the skeleton and the side by name."""
    rig = read_hand_rig(bpy.context, hand)
    assert rig.side == ("left" if hand.name.startswith("l_") else "right")
    assert len(rig.vertices) == 1159 and len(rig.faces) == 2314
    assert 425 < len(rig.nodes) < 575
    assert (tetrahedron_volumes(rig.nodes, rig.tetrahedra) > 0.0).all()
    assert hand_parts(rig.vertices, rig.faces).finger_count == 5
    parents = {
        name: rig.bone_names[parent] if parent >= 0 else None
        for name, parent in zip(rig.bone_names, rig.bone_parent, strict=True)
    }
    assert parents["index-finger-phalanx-distal"] == "index-finger-phalanx-intermediate"
    assert parents["thumb-metacarpal"] == "wrist" and parents["wrist"] is None


def test_curled_hand_matches_blenders(hand: Any) -> None:
    """Keep the embedded skin within millimeters of Blender's while the fingers curl."""
    rig = read_hand_rig(bpy.context, hand)
    rest = np.array([vertex.co for vertex in hand.data.vertices])
    assert np.allclose(hand.matrix_world, np.eye(4))
    for angle in (0.0, 0.5, 1.0, 1.5):
        curl(hand, angle)
        bones = hand_bone_matrices(hand, bpy.context.evaluated_depsgraph_get())
        nodes = rig.skinned_nodes(bones)
        errors = np.linalg.norm(
            rig.carried_vertices(nodes) - shown_vertices(hand, rig, rest), axis=1
        )
        assert np.median(errors) < 1e-6 + 5e-4 * angle
        assert np.percentile(errors, 99) < 1e-6 + 3e-3 * angle
        assert errors.max() < 1e-6 + 6e-3 * angle
        assert (tetrahedron_volumes(nodes, rig.tetrahedra) <= 0.0).mean() < 0.01
