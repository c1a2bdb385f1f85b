# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing the brush's tool over the 3D view. It is not an object, so Undo, files and the Outliner
do not contain it."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.geometry.rotations import frame_of, tangent_of
from ..base.units import meters_per_unit
from ..core.brush.brush import Brush
from ..core.brush.mirror import mirror_matrices
from ..core.tools.settings import ToolMesh

_TOUCHING = (0.82, 0.80, 0.76, 0.92)
_HOVERING = (0.82, 0.80, 0.76, 0.45)
"""Colors of a tool that acts on the clay, and of one that hovers; linear RGBA."""
_RING = (1.0, 1.0, 1.0, 0.55)
_ARC = (1.0, 0.55, 0.25, 0.95)
_SEGMENTS = 64
_SHARP = np.cos(np.radians(40.0))
"""Cosine of the angle from which an edge is drawn sharp."""

_VERTEX = """
void main()
{
  shown_normal = normal;
  gl_Position = clip_from_tool * vec4(pos, 1.0);
}
"""
_FRAGMENT = """
void main()
{
  vec3 n = normalize(shown_normal);
  float key = max(dot(n, light), 0.0);
  float facing = abs(dot(n, eye));
  float rim = pow(1.0 - facing, 3.0);
  vec3 lit = color.rgb * (0.30 + 0.70 * key) + vec3(0.25 * rim);
  fragment = vec4(lit, clamp(color.a + 0.4 * rim, 0.0, 1.0));
}
"""


class BrushOverlay:
    """Draws a brush over every 3D view between `show` and `hide`."""

    def __init__(self) -> None:
        self.brush: Brush | None = None
        """The brush that is drawn, if any."""
        self._handle: Any = None
        self._shader: Any = None
        self._batches: dict[int, tuple[ToolMesh, Any]] = {}

    def show(self, brush: Brush) -> None:
        """Start drawing a brush; in the background nothing is drawn."""
        self.brush = brush
        if self._handle is None and not bpy.app.background:
            self._handle = bpy.types.SpaceView3D.draw_handler_add(
                self._draw, (), "WINDOW", "POST_VIEW"
            )

    def hide(self) -> None:
        """Stop drawing; a second call does nothing."""
        self.brush = None
        self._batches.clear()
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None

    def forget_shader(self) -> None:
        """Release the shader, which is created again when needed."""
        self._shader = None

    def _draw(self) -> None:
        scene, view = bpy.context.scene, bpy.context.region_data
        if self.brush is None or scene is None or view is None:
            return
        if bpy.context.space_data.overlay:
            view_matrix = np.array(view.view_matrix, np.float64)
            self.draw(self.brush, view_matrix, scale=meters_per_unit(scene))

    def draw(self, brush: Brush, view_matrix: NDArray[np.float64], *, scale: float) -> None:
        """Draw a brush with the current matrices of the GPU module.

        Args:
            brush: The brush; its tool, mirrored copies and cursor are drawn.
            view_matrix: World to camera space [Blender units], shape [4, 4].
            scale: Length of a Blender unit [m].
        """
        import gpu

        try:
            gpu.state.blend_set("ALPHA")
            drawn = brush.drawn()
            self._forget_batches([mesh for mesh, _, _ in drawn])
            for mesh, pose, enabled in drawn:
                self._draw_mesh(mesh, pose, view_matrix, scale, _TOUCHING if enabled else _HOVERING)
            if brush.cursor is not None:
                _draw_ring(brush, scale)
        finally:
            gpu.state.depth_mask_set(False)
            gpu.state.depth_test_set("NONE")
            gpu.state.face_culling_set("NONE")
            gpu.state.blend_set("NONE")

    def _draw_mesh(
        self,
        mesh: ToolMesh,
        pose: NDArray[np.float64],
        view_matrix: NDArray[np.float64],
        scale: float,
        color: tuple[float, float, float, float],
    ) -> None:
        import gpu
        from mathutils import Matrix

        shader = self._tool_shader()
        model = pose.copy()
        model[:3] /= scale
        projection = gpu.matrix.get_projection_matrix() @ gpu.matrix.get_model_view_matrix()
        back = np.linalg.inv(view_matrix[:3, :3] @ model[:3, :3])
        shader.bind()
        shader.uniform_float("clip_from_tool", projection @ Matrix(model.tolist()))
        for name, way in (("light", (-0.35, 0.65, 0.7)), ("eye", (0.0, 0.0, 1.0))):
            own = back @ np.array(way)
            shader.uniform_float(name, (own / np.linalg.norm(own)).tolist())
        shader.uniform_float("color", color)
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.depth_mask_set(True)
        # Mirroring reverses the winding of the triangles.
        gpu.state.face_culling_set("FRONT" if np.linalg.det(model[:3, :3]) < 0.0 else "BACK")
        self._batch(mesh, shader).draw(shader)

    def _tool_shader(self) -> Any:
        if self._shader is None:
            import gpu

            between = gpu.types.GPUStageInterfaceInfo("clay_tool_interface")
            between.smooth("VEC3", "shown_normal")
            info = gpu.types.GPUShaderCreateInfo()
            info.push_constant("MAT4", "clip_from_tool")
            info.push_constant("VEC4", "color")
            info.push_constant("VEC3", "light")
            info.push_constant("VEC3", "eye")
            info.vertex_in(0, "VEC3", "pos")
            info.vertex_in(1, "VEC3", "normal")
            info.vertex_out(between)
            info.fragment_out(0, "VEC4", "fragment")
            info.vertex_source(_VERTEX)
            info.fragment_source(_FRAGMENT)
            self._shader = gpu.shader.create_from_info(info)
        return self._shader

    def _batch(self, mesh: ToolMesh, shader: Any) -> Any:
        from gpu_extras.batch import batch_for_shader

        kept = self._batches.get(id(mesh))
        if kept is None:
            points, normals = shaded_corners(mesh)
            batch = batch_for_shader(shader, "TRIS", {"pos": points, "normal": normals})
            kept = self._batches[id(mesh)] = (mesh, batch)
        return kept[1]

    def _forget_batches(self, meshes: list[ToolMesh]) -> None:
        used = {id(mesh) for mesh in meshes}
        for key in [key for key in self._batches if key not in used]:
            del self._batches[key]


overlay = BrushOverlay()


def shaded_corners(mesh: ToolMesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Corners of a mesh's triangles, with normals that are smooth except at sharp edges.

    Returns:
        Positions [m] and unit normals, shape [3 F, 3] each.
    """
    corners = mesh.vertices[mesh.faces]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    smooth = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(smooth, mesh.faces[:, corner], face)
    flat = face / np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-30)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-30)
    normals = smooth[mesh.faces]
    sharp = np.einsum("fkd,fd->fk", normals, flat) < _SHARP
    normals[sharp] = np.broadcast_to(flat[:, None], normals.shape)[sharp]
    return (
        corners.reshape(-1, 3).astype(np.float32),
        normals.reshape(-1, 3).astype(np.float32),
    )


def _draw_ring(brush: Brush, scale: float) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    cursor, settings = brush.cursor, brush.settings
    assert cursor is not None
    gpu.state.depth_test_set("NONE")
    gpu.state.depth_mask_set(False)
    gpu.state.face_culling_set("NONE")
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    shader.bind()
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    ring = ring_points(cursor.point, cursor.normal, settings.radius)
    arc = ring_points(cursor.point, cursor.normal, 0.92 * settings.radius, settings.strength)
    paint = (*settings.color[:3], 0.95) if settings.tool.edit else _ARC
    for matrix in mirror_matrices(settings.mirror, settings.mirror_frame):
        for points, color, width in ((ring, _RING, 1.5), (arc, paint, 3.0)):
            if len(points) < 2:
                continue
            moved = (points @ matrix[:3, :3].T + matrix[:3, 3]) / scale
            shader.uniform_float("lineWidth", width)
            shader.uniform_float("color", color)
            batch_for_shader(shader, "LINE_STRIP", {"pos": moved.astype(np.float32)}).draw(shader)


def ring_points(
    point: NDArray[np.float64], normal: NDArray[np.float64], radius: float, part: float = 1.0
) -> NDArray[np.float64]:
    """Points along a circle around a normal, or along part of it.

    Args:
        point: Center [m], shape [3].
        normal: Unit vector, shape [3].
        radius: Radius [m].
        part: Fraction of the circle, 0 to 1.

    Returns:
        Points of a polyline [m], shape [S, 3].
    """
    up = tangent_of(np.array((0.0, 0.0, 1.0)), normal, np.array((0.0, 1.0, 0.0)))
    x, y, _ = frame_of(normal, up).T
    turn = np.linspace(0.0, 2.0 * np.pi * part, int(np.ceil(_SEGMENTS * part)) + 1)[:, None]
    # Clockwise from the top.
    return np.asarray(point + radius * (np.sin(turn) * x + np.cos(turn) * y))


def register() -> None:
    """Nothing to register: drawing starts with a session."""


def unregister() -> None:
    """Stop drawing."""
    overlay.hide()
    overlay.forget_shader()
