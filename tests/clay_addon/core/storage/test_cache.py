# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache on disk: what is written comes back, and nothing damaged passes for a frame."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.storage.cache import (
    Cache,
    CacheDamagedError,
    CacheError,
    CacheMissingError,
    ClaySlice,
    Frame,
    Meta,
)

META = Meta(
    start=1,
    end=4,
    frames_per_second=24.0,
    clay=(ClaySlice("Clay", 3), ClaySlice("Lump", 2)),
    settings={"gravity": "abc"},
    owner="../scene.blend|Scene",
    version="1.0",
)


def make_frame(number: int, seed: int = 0) -> Frame:
    """Return a frame of five particles."""
    random = np.random.default_rng([abs(number), seed])
    positions, velocities = random.normal(size=(2, 5, 3)).astype(np.float32)
    return Frame(number, positions, velocities, b"i" * 16)


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    """Return a cache with a bake of frames 1 to 3 of 4."""
    cache = Cache(tmp_path / "cache")
    cache.begin(META, np.ones((5, 4)))
    for number in (1, 2, 3):
        cache.write_frame(make_frame(number), META)
    return cache


names = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
metas = st.builds(
    lambda start, length, **rest: Meta(start=start, end=start + length, **rest),
    start=st.integers(-(10**6), 10**6),
    length=st.integers(0, 10**6),
    frames_per_second=st.floats(1e-3, 1e6),
    clay=st.lists(st.builds(ClaySlice, names, st.integers(1, 10**9)), max_size=4).map(tuple),
    settings=st.dictionaries(names, names, max_size=4),
    owner=names,
    version=names,
    statistics=st.dictionaries(names, st.floats(allow_nan=False, allow_infinity=False)),
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | names,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3),
    max_leaves=8,
)


@given(metas)
def test_meta_comes_back_as_written(meta: Meta) -> None:
    """Read back any meta.json that was written, and the same digest with it."""
    again = Meta.from_json(meta.to_json())
    assert again == meta
    assert again.digest == meta.digest


@given(st.text() | json_values.map(json.dumps))
def test_any_other_meta_is_called_damaged(text: str) -> None:
    """Say that a meta.json is damaged, whatever it holds instead."""
    with pytest.raises(CacheDamagedError):
        Meta.from_json(text)


@given(st.data())
def test_meta_with_one_entry_changed_is_read_or_called_damaged(data: st.DataObject) -> None:
    """Raise no other error for a meta.json in which one entry was replaced or removed."""
    table = json.loads(META.to_json())
    key = data.draw(st.sampled_from(sorted(table)))
    if data.draw(st.booleans()):
        del table[key]
    else:
        table[key] = data.draw(json_values)
    try:
        meta = Meta.from_json(json.dumps(table))
    except CacheDamagedError:
        return
    assert meta.particle_count == 5


@given(number=st.integers(-99999, 10**7), seed=st.integers(0, 2**32))
def test_frame_comes_back_as_written(
    tmp_path_factory: pytest.TempPathFactory, number: int, seed: int
) -> None:
    """Read back the very bits of a frame, under any frame number."""
    cache = Cache(tmp_path_factory.getbasetemp() / "any-frame")
    cache.begin(META, np.ones((5, 4)))
    frame = make_frame(number, seed)
    cache.write_frame(frame, META)
    assert cache.frames() == [number]
    again = cache.read_frame(number)
    assert again.positions.tobytes() == frame.positions.tobytes()
    assert again.velocities.tobytes() == frame.velocities.tobytes()
    assert again.inputs == frame.inputs


def test_equal_frames_make_equal_files(cache: Cache, tmp_path: Path) -> None:
    """Write the same bytes for the same frame, whenever it is written."""
    other = Cache(tmp_path / "other")
    other.begin(META, np.ones((5, 4)))
    other.write_frame(make_frame(2), META)
    assert other.frame_path(2).read_bytes() == cache.frame_path(2).read_bytes()


def test_every_truncation_is_noticed(cache: Cache) -> None:
    """Call a frame damaged wherever its file was cut off."""
    path = cache.frame_path(2)
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(CacheDamagedError, match=path.name):
            cache.read_frame(2)


def test_no_flipped_bit_changes_a_frame_unnoticed(cache: Cache) -> None:
    """Give the frame as it was or call it damaged, whichever byte was altered."""
    path = cache.frame_path(2)
    whole = path.read_bytes()
    frame = make_frame(2)
    noticed = 0
    for place in range(0, len(whole), 3):
        altered = bytearray(whole)
        altered[place] ^= 1 << place % 8
        path.write_bytes(altered)
        try:
            again = cache.read_frame(2)
        except CacheDamagedError:
            noticed += 1
            continue
        assert again.positions.tobytes() == frame.positions.tobytes()
        assert again.velocities.tobytes() == frame.velocities.tobytes()
        assert again.inputs == frame.inputs
    assert noticed > len(whole) / 6


def test_damaged_frame_counts_as_missing(cache: Cache) -> None:
    """Leave a truncated frame out of the whole ones."""
    path = cache.frame_path(2)
    path.write_bytes(path.read_bytes()[:-100])
    assert cache.frames() == [1, 2, 3]
    assert sorted(cache.whole_frames(1, 4)) == [1, 3]


def test_frame_of_another_bake_or_number_is_refused(cache: Cache) -> None:
    """Notice a frame that was renamed, or left by a bake with other settings."""
    cache.frame_path(2).rename(cache.frame_path(4))
    with pytest.raises(CacheDamagedError, match="another bake or frame"):
        cache.read_frame(4)
    other = Meta(**{**vars(META), "settings": {"gravity": "xyz"}})
    cache.write_meta(other)
    with pytest.raises(CacheDamagedError, match="another bake or frame"):
        cache.read_frame(1)


def test_missing_frame_is_told_from_a_damaged_one(cache: Cache) -> None:
    """Say that a frame is missing where it was never baked."""
    with pytest.raises(CacheMissingError, match=r"frame_000004\.npz is missing"):
        cache.read_frame(4)


def test_missing_folder_holds_no_bake(tmp_path: Path) -> None:
    """Read a folder that is not there as an empty cache, and make none by looking."""
    cache = Cache(tmp_path / "nowhere")
    assert (cache.exists(), cache.frames(), cache.size()) == (False, [], 0)
    with pytest.raises(CacheMissingError, match="no bake"):
        cache.meta()
    assert not cache.directory.exists()


def test_checkpoint_comes_back_and_belongs_to_its_bake(cache: Cache) -> None:
    """Read back every array of a checkpoint, and refuse one of another bake."""
    snapshot = {"time": np.array(0.5), "bond": np.arange(6).reshape(2, 3), "none": np.zeros(0)}
    cache.write_checkpoint(2, snapshot, META)
    again = cache.read_checkpoint(2)
    assert set(again) == set(snapshot)
    for name, array in snapshot.items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == array.dtype
    with pytest.raises(CacheDamagedError, match="another bake"):
        cache.read_checkpoint(2, meta=Meta(**{**vars(META), "start": 0}))


def test_free_removes_what_is_the_caches_and_nothing_else(cache: Cache) -> None:
    """Leave files that the cache did not write, and the folder as long as one is in it."""
    notes = cache.directory / "notes.txt"
    notes.write_text("mine")
    size = cache.size()
    assert cache.free() == size > 0
    assert list(cache.directory.iterdir()) == [notes]
    notes.unlink()
    cache.free()
    assert not cache.directory.exists()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_full_disk_leaves_no_damaged_file(
    cache: Cache, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """Say that the disk is full, keep the frames so far, and leave no half-written file."""

    def full(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    before = sorted(cache.directory.iterdir())
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CacheError, match=r"The disk is full.*Resume"):
        cache.write_frame(make_frame(4), META)
    with pytest.raises(CacheError, match="The disk is full"):
        cache.write_frame(make_frame(2, seed=1), META)
    monkeypatch.undo()
    assert sorted(cache.directory.iterdir()) == before
    assert cache.read_frame(2).positions.tobytes() == make_frame(2).positions.tobytes()


LIMITED = """
import resource, signal, sys
import numpy as np
from tactile_clay.clay_addon.core.storage.cache import Cache, CacheError, ClaySlice, Frame, Meta

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
meta = Meta(1, 2, 24.0, (ClaySlice("Clay", 4000),), {})
cache = Cache(sys.argv[1])
cache.begin(meta, np.ones((4000, 4)))
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    cache.write_frame(Frame(1, np.zeros((4000, 3)), np.zeros((4000, 3))), meta)
except CacheError as error:
    print(error)
print(sorted(path.name for path in cache.directory.iterdir()))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits on the size of files")
def test_write_that_the_system_cuts_short_leaves_nothing(tmp_path: Path) -> None:
    """Leave no part of a frame where the system really stops the write in the middle."""
    result = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path / "cache")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "frame_000001.npz could not be written" in result.stdout
    assert result.stdout.splitlines()[-1] == "['colors.npz', 'meta.json']"


READ_ONLY = """
import os, sys
from pathlib import Path
from tactile_clay.clay_addon.core.storage.cache import Cache, CacheError

folder = Path(sys.argv[1])
folder.chmod(0o555)
if os.geteuid() == 0:
    folder.parent.chmod(0o755)
    os.setuid(65534)
try:
    Cache(folder if sys.argv[2] == "itself" else folder / "below").prepare()
except CacheError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX permissions")
@pytest.mark.parametrize("where", ["itself", "below"])
def test_read_only_folder_is_refused_before_any_work(tmp_path: Path, where: str) -> None:
    """Say that a folder cannot be written to, also where it cannot be made."""
    folder = tmp_path / "cache"
    folder.mkdir()
    for parent in (tmp_path, *tmp_path.parents[:2]):
        parent.chmod(0o755)
    result = subprocess.run(
        [sys.executable, "-c", READ_ONLY, str(folder), where],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "cannot be written to (Permission denied). Choose another folder" in result.stdout


def test_folder_whose_name_is_a_file_is_refused(tmp_path: Path) -> None:
    """Say that the folder cannot be made where a file has its name."""
    (tmp_path / "file").write_text("")
    with pytest.raises(CacheError, match="cannot be written to"):
        Cache(tmp_path / "file").prepare()


def test_leftovers_of_a_killed_process_are_removed(cache: Cache) -> None:
    """Clear temporary files away before the next bake."""
    (cache.directory / ".clay-123-frame_000004.tmp").write_bytes(b"half")
    cache.prepare()
    assert not list(cache.directory.glob(".clay-*"))


def test_two_processes_do_not_write_at_once(cache: Cache) -> None:
    """Refuse the folder while another bake has it, and take it as soon as that ends."""
    with cache.locked(), pytest.raises(CacheError, match="Another process"), cache.locked():
        pass
    with cache.locked():
        pass


def test_cache_needs_no_blender() -> None:
    """Read a cache from scripts that have no bpy."""
    source = (
        "import sys; sys.modules['bpy'] = None; import tactile_clay.clay_addon.core.storage.cache"
    )
    subprocess.run([sys.executable, "-c", source], check=True)


def test_foreign_meta_is_left_alone(tmp_path: Path) -> None:
    """Neither bake over a meta.json that no bake wrote nor remove it."""
    path = tmp_path / "meta.json"
    path.write_text('{"model": "mine"}')
    for work in (lambda: Cache(tmp_path).begin(META, np.ones((5, 4))), Cache(tmp_path).free):
        with pytest.raises(CacheError, match=r"meta\.json is not of a bake.*another cache folder"):
            work()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == '{"model": "mine"}'


def test_damaged_meta_of_a_bake_is_baked_over(cache: Cache) -> None:
    """Start afresh where the frames show that a bake was there."""
    (cache.directory / "meta.json").write_text("garbage")
    cache.begin(META, np.ones((5, 4)))
    assert (cache.meta(), cache.frames()) == (META, [])


def test_bake_is_not_freed_while_another_process_bakes(cache: Cache) -> None:
    """Leave the frames of a bake that runs."""
    with cache.locked(), pytest.raises(CacheError, match="Another process"):
        Cache(cache.directory).free()
    assert cache.frames() == [1, 2, 3]


@pytest.mark.parametrize("name", ["clay.lock", "frame_000004.npz"])
def test_folder_in_the_place_of_a_file_is_said(cache: Cache, name: str) -> None:
    """Name what is in the way, whatever is done to the cache."""
    (cache.directory / name).mkdir()
    with pytest.raises(CacheError, match=name):
        cache.free()
    with pytest.raises(CacheError, match=name), cache.locked():
        cache.begin(META, np.ones((5, 4)))


def test_size_can_be_told_while_files_go(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    """Count what is there while another process renames its files."""
    gone = cache.directory / ".clay-1-frame_000009.tmp"
    size = cache.size()
    monkeypatch.setattr(cache, "_own_files", lambda: [gone, *Cache._own_files(cache)])
    assert cache.size() == size


def test_damaged_frame_is_called_that_and_no_more(cache: Cache) -> None:
    """Pass on no advice to unpickle a file of unknown content."""
    cache.frame_path(2).write_bytes(b"x")
    with pytest.raises(CacheDamagedError, match=r"^frame_000002\.npz is damaged$"):
        cache.read_frame(2)
