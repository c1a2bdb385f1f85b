# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading and writing a cache, and detection of damaged files."""

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
def test_meta_survives_a_round_trip(meta: Meta) -> None:
    """Any metadata is read back equal and with the same digest."""
    again = Meta.from_json(meta.to_json())
    assert again == meta
    assert again.digest == meta.digest


@given(st.text() | json_values.map(json.dumps))
def test_invalid_meta_is_reported_as_damaged(text: str) -> None:
    """Arbitrary text or JSON raises CacheDamagedError."""
    with pytest.raises(CacheDamagedError):
        Meta.from_json(text)


@given(st.data())
def test_meta_with_one_entry_changed_is_read_or_reported_as_damaged(data: st.DataObject) -> None:
    """A meta.json with one entry replaced or removed raises no other error."""
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
def test_frame_survives_a_round_trip(
    tmp_path_factory: pytest.TempPathFactory, number: int, seed: int
) -> None:
    """A frame with any number is read back bit for bit."""
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
    """The bytes of a frame's file do not depend on when it is written."""
    other = Cache(tmp_path / "other")
    other.begin(META, np.ones((5, 4)))
    other.write_frame(make_frame(2), META)
    assert other.frame_path(2).read_bytes() == cache.frame_path(2).read_bytes()


def test_every_truncation_is_detected(cache: Cache) -> None:
    """A frame file cut off anywhere is reported as damaged."""
    path = cache.frame_path(2)
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(CacheDamagedError, match=path.name):
            cache.read_frame(2)


def test_no_flipped_bit_changes_a_frame_undetected(cache: Cache) -> None:
    """With any byte altered, the frame is read unchanged or reported as damaged."""
    path = cache.frame_path(2)
    whole = path.read_bytes()
    frame = make_frame(2)
    detected = 0
    for position in range(0, len(whole), 3):
        altered = bytearray(whole)
        altered[position] ^= 1 << position % 8
        path.write_bytes(altered)
        try:
            again = cache.read_frame(2)
        except CacheDamagedError:
            detected += 1
            continue
        assert again.positions.tobytes() == frame.positions.tobytes()
        assert again.velocities.tobytes() == frame.velocities.tobytes()
        assert again.inputs == frame.inputs
    assert detected > len(whole) / 6


def test_damaged_frame_counts_as_missing(cache: Cache) -> None:
    """A truncated frame is not among the intact ones."""
    path = cache.frame_path(2)
    path.write_bytes(path.read_bytes()[:-100])
    assert cache.frames() == [1, 2, 3]
    assert sorted(cache.intact_frames(1, 4)) == [1, 3]


def test_frame_of_another_bake_or_number_is_refused(cache: Cache) -> None:
    """A frame that was renamed or left by a bake with other settings is detected."""
    cache.frame_path(2).rename(cache.frame_path(4))
    with pytest.raises(CacheDamagedError, match="another bake or frame"):
        cache.read_frame(4)
    other = Meta(**{**vars(META), "settings": {"gravity": "xyz"}})
    cache.write_meta(other)
    with pytest.raises(CacheDamagedError, match="another bake or frame"):
        cache.read_frame(1)


def test_missing_frame_is_not_reported_as_damaged(cache: Cache) -> None:
    """A frame that was never baked raises CacheMissingError."""
    with pytest.raises(CacheMissingError, match=r"frame_000004\.npz is missing"):
        cache.read_frame(4)


def test_missing_folder_is_an_empty_cache(tmp_path: Path) -> None:
    """A folder that does not exist reads as an empty cache, and is not created."""
    cache = Cache(tmp_path / "nowhere")
    assert (cache.exists(), cache.frames(), cache.size()) == (False, [], 0)
    with pytest.raises(CacheMissingError, match="no bake"):
        cache.meta()
    assert not cache.directory.exists()


def test_checkpoint_survives_a_round_trip_and_belongs_to_its_bake(cache: Cache) -> None:
    """Every array of a checkpoint is read back; a checkpoint from another bake is refused."""
    snapshot = {"time": np.array(0.5), "bond": np.arange(6).reshape(2, 3), "none": np.zeros(0)}
    cache.write_checkpoint(2, snapshot, META)
    again = cache.read_checkpoint(2)
    assert set(again) == set(snapshot)
    for name, array in snapshot.items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == array.dtype
    with pytest.raises(CacheDamagedError, match="another bake"):
        cache.read_checkpoint(2, meta=Meta(**{**vars(META), "start": 0}))


def test_free_removes_only_files_of_the_cache(cache: Cache) -> None:
    """Other files are left, and so is the folder until they are gone."""
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
    """A full disk is reported, and leaves earlier frames intact and no partial file."""

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
def test_interrupted_write_leaves_nothing(tmp_path: Path) -> None:
    """A write that the operating system really stops midway leaves no part of a frame."""
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
    """A folder that cannot be written to or created is reported."""
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


def test_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    """A cache folder cannot be created where a file has its name."""
    (tmp_path / "file").write_text("")
    with pytest.raises(CacheError, match="cannot be written to"):
        Cache(tmp_path / "file").prepare()


def test_leftovers_of_a_killed_process_are_removed(cache: Cache) -> None:
    """Temporary files are removed before the next bake."""
    (cache.directory / ".clay-123-frame_000004.tmp").write_bytes(b"half")
    cache.prepare()
    assert not list(cache.directory.glob(".clay-*"))


def test_two_processes_do_not_write_at_once(cache: Cache) -> None:
    """A folder is refused while another bake holds its lock, and accepted right afterward."""
    with cache.locked(), pytest.raises(CacheError, match="Another process"), cache.locked():
        pass
    with cache.locked():
        pass


def test_cache_needs_no_blender() -> None:
    """Scripts without bpy can import the cache."""
    source = (
        "import sys; sys.modules['bpy'] = None; import tactile_clay.clay_addon.core.storage.cache"
    )
    subprocess.run([sys.executable, "-c", source], check=True)


def test_foreign_meta_is_left_alone(tmp_path: Path) -> None:
    """A meta.json that is not from a bake is neither overwritten nor removed."""
    path = tmp_path / "meta.json"
    path.write_text('{"model": "mine"}')
    for work in (lambda: Cache(tmp_path).begin(META, np.ones((5, 4))), Cache(tmp_path).free):
        with pytest.raises(
            CacheError, match=r"meta\.json is not from a bake.*another cache folder"
        ):
            work()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == '{"model": "mine"}'


def test_damaged_meta_of_a_bake_is_overwritten(cache: Cache) -> None:
    """A new bake may start in a folder whose frames show that it held a bake."""
    (cache.directory / "meta.json").write_text("garbage")
    cache.begin(META, np.ones((5, 4)))
    assert (cache.meta(), cache.frames()) == (META, [])


def test_bake_is_not_freed_while_another_process_bakes(cache: Cache) -> None:
    """The frames of a running bake are kept."""
    with cache.locked(), pytest.raises(CacheError, match="Another process"):
        Cache(cache.directory).free()
    assert cache.frames() == [1, 2, 3]


@pytest.mark.parametrize("name", ["clay.lock", "frame_000004.npz"])
def test_folder_in_place_of_a_file_is_reported(cache: Cache, name: str) -> None:
    """Error messages name a folder that has the name of a cache file."""
    (cache.directory / name).mkdir()
    with pytest.raises(CacheError, match=name):
        cache.free()
    with pytest.raises(CacheError, match=name), cache.locked():
        cache.begin(META, np.ones((5, 4)))


def test_size_ignores_files_that_disappear(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    """The size can be computed while another process renames its files."""
    removed = cache.directory / ".clay-1-frame_000009.tmp"
    size = cache.size()
    monkeypatch.setattr(cache, "_own_files", lambda: [removed, *Cache._own_files(cache)])
    assert cache.size() == size


def test_message_about_a_damaged_frame_does_not_suggest_pickle(cache: Cache) -> None:
    """numpy's advice to allow pickle is not passed on."""
    cache.frame_path(2).write_bytes(b"x")
    with pytest.raises(CacheDamagedError, match=r"^frame_000002\.npz is damaged$"):
        cache.read_frame(2)
