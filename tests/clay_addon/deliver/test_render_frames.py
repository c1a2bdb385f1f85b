# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering of baked frames in parts, atomically."""

import shutil
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.command.line import main
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.deliver.render_frames import (
    FrameNotBakedError,
    RenderError,
    RenderProgress,
    render_frames,
)


@pytest.fixture
def shot(studio: Any, tmp_path: Path) -> Path:
    """A saved file with a block falling onto a table, a camera, and a bake of frames 1 to 6."""
    studio.falling_block(tmp_path)
    studio.camera()
    bake(bpy.context)
    return Path(studio.save(tmp_path))


def pixels(path: Path) -> Any:
    """Pixel values of an image."""
    image = bpy.data.images.load(str(path))
    values = np.array(image.pixels[:])
    bpy.data.images.remove(image)
    return values


def test_frames_are_rendered_in_parts(shot: Path, studio: Any, tmp_path: Path) -> None:
    """Frames can be rendered in parts; the scene's settings are restored."""
    render = studio.scene.render
    before = (render.filepath, studio.scene.frame_current, studio.scene.frame_end)
    reports: list[RenderProgress] = []
    pattern = tmp_path / "pictures" / "a_###"
    first = render_frames(bpy.context, [1, 6], output=pattern, progress=reports.append)
    assert (first.rendered, first.kept) == (2, 0)
    assert [path.name for path in first.files] == ["a_001.png", "a_006.png"]
    assert [(each.frame, each.done, each.total) for each in reports] == [(1, 1, 2), (6, 2, 2)]
    picture = first.files[0].read_bytes()
    second = render_frames(bpy.context, [1, 2, 6], output=pattern, resume=True)
    assert (second.rendered, second.kept) == (1, 2)
    assert sorted(path.name for path in pattern.parent.iterdir()) == [
        "a_001.png",
        "a_002.png",
        "a_006.png",
    ]
    assert first.files[0].read_bytes() == picture
    # The clay has fallen in between.
    assert np.abs(pixels(first.files[0]) - pixels(first.files[1])).max() > 0.05
    assert (render.filepath, studio.scene.frame_current, studio.scene.frame_end) == before


def test_frame_that_is_not_baked_is_refused_before_anything_is_rendered(
    shot: Path, tmp_path: Path
) -> None:
    """Missing frames are named, even inside the bake, and no image is written."""
    (tmp_path / "clay_cache" / "frame_000003.npz").unlink()
    with pytest.raises(FrameNotBakedError, match=r"frame 3, 7\. "):
        render_frames(bpy.context, [1, 2, 3, 7], output=tmp_path / "out" / "####")
    assert not (tmp_path / "out").exists()


def test_damaged_frame_is_not_rendered(shot: Path, tmp_path: Path) -> None:
    """Rendering stops at a damaged frame and keeps the images before it."""
    Cache(tmp_path / "clay_cache").frame_path(2).write_bytes(b"PK")
    with pytest.raises(FrameNotBakedError, match=r"Frame 2: .* damaged"):
        render_frames(bpy.context, [1, 2], output=tmp_path / "out" / "####")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["0001.png"]


def test_obstacles_to_rendering_are_reported(shot: Path, studio: Any, tmp_path: Path) -> None:
    """Videos, a scene without a camera and a file in place of a folder are refused."""
    settings = studio.scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "VIDEO"
    settings.file_format = "FFMPEG"
    with pytest.raises(RenderError, match="is a video"):
        render_frames(bpy.context, [1])
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format = "PNG"
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RenderError, match="cannot be written"):
        render_frames(bpy.context, [1], output=tmp_path / "file" / "####")
    assert (tmp_path / "file").read_text() == "in the way"
    studio.scene.camera = None
    with pytest.raises(RenderError, match=r"Frame 1 cannot be rendered: .*camera"):
        render_frames(bpy.context, [1], output=tmp_path / "####")


def test_images_are_written_atomically(
    shot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If writing fails midway, the old image is kept and no part of the new one is left."""
    (path,) = render_frames(bpy.context, [1], output=tmp_path / "out" / "####").files
    path.write_bytes(b"old")

    def fail(source: Any, target: Any) -> None:
        target.write(source.read(100))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "copyfileobj", fail)
    with pytest.raises(RenderError, match="No space left"):
        render_frames(bpy.context, [1], output=tmp_path / "out" / "####")
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert path.read_bytes() == b"old"


def test_command_renders_from_a_cache_elsewhere(
    shot: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The command renders a list of frames from another cache, and prints each image."""
    (tmp_path / "clay_cache").rename(tmp_path / "elsewhere")
    options = ["--frames=1-2,4", "--output", str(tmp_path / "out" / "f_####")]
    assert main(["render", str(shot), *options]) == 3
    assert "Nothing is baked in" in capfd.readouterr().err
    assert main(["render", str(shot), *options, "--cache", str(tmp_path / "elsewhere")]) == 0
    captured = capfd.readouterr()
    assert captured.out.startswith("3 frames rendered, 0 kept.\nImages: ")
    for number in (1, 2, 4):
        assert f"\nSaved: '{tmp_path / 'out' / f'f_{number:04}.png'}'\n" in captured.err
    assert main(["render", str(shot), "--frames", "1;2"]) == 2
    assert "'1;2' is not a range such as 1-120" in capfd.readouterr().err


def test_frames_that_need_no_bake_are_rendered_without_one(
    shot: Path, studio: Any, tmp_path: Path
) -> None:
    """Keyed poses, held shapes and deliveries need no baked frame of the same number."""
    studio.scene.tactile_clay.hold_frames = 2
    (tmp_path / "clay_cache" / "frame_000002.npz").unlink()
    held = render_frames(bpy.context, [1, 2], output=tmp_path / "held" / "####")
    assert (pixels(held.files[0]) == pixels(held.files[1])).all()
    studio.scene.frame_set(1)
    assert bpy.ops.clay.pose_key() == {"FINISHED"}
    shutil.rmtree(tmp_path / "clay_cache")
    posed = render_frames(bpy.context, [4], output=tmp_path / "posed" / "####")
    assert posed.rendered == 1
    assert bpy.ops.clay.pose_remove() == {"FINISHED"}
    with pytest.raises(FrameNotBakedError):
        render_frames(bpy.context, [4], output=tmp_path / "none" / "####")
    assert bpy.ops.clay.deliver() == {"FINISHED"}
    delivered = render_frames(bpy.context, [4], output=tmp_path / "delivered" / "####")
    assert delivered.rendered == 1
