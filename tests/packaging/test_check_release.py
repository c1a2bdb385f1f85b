# SPDX-License-Identifier: GPL-3.0-or-later
"""The check before a release is content with what was built, and names what is wrong."""

import io
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest


def check(repository: Path, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run the check on a folder."""
    command = [sys.executable, str(repository / "tools" / "check_release.py"), str(folder)]
    return subprocess.run([*command, *options], capture_output=True, text=True, check=False)


def rewrite(path: Path, changes: dict[str, bytes | None]) -> None:
    """Replace, add or drop (None) files in a zip."""
    with zipfile.ZipFile(path) as archive:
        files: dict[str, bytes | None] = {
            name: archive.read(name) for name in archive.namelist() if not name.endswith("/")
        }
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (files | changes).items():
            if content is not None:
                archive.writestr(name, content)


def wheel(license_line: str) -> bytes:
    """A wheel that holds nothing but a licence."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        text = f"Metadata-Version: 2.4\nName: pyusb\nVersion: 1.3.1\n{license_line}\n"
        archive.writestr("pyusb-1.3.1.dist-info/METADATA", text)
    return content.getvalue()


@pytest.fixture
def release(extension_zip_without_wheels: Path, tmp_path: Path) -> Path:
    """A folder with a copy of this machine's zip, without wheels, and its index."""
    for name in (extension_zip_without_wheels.name, "index.json"):
        shutil.copy(extension_zip_without_wheels.parent / name, tmp_path)
    return tmp_path


def test_whole_release_passes(repository: Path, request: pytest.FixtureRequest) -> None:
    """Pass the zip with its wheels, and list the licence of each."""
    if not list((repository / "wheels").glob("warp_lang-*.whl")):
        pytest.skip("the wheels are not here: run `make extension` once")
    folder = request.getfixturevalue("extension_zip").parent
    result = check(repository, folder, "--platforms", "here")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.count(".whl: ") == 6
    assert "trimesh-5.2.0-py3-none-any.whl: MIT\n" in result.stdout


def test_what_does_not_belong_or_is_missing_is_named(repository: Path, release: Path) -> None:
    """Name each test, cache, altered and missing file, and wheels that are not there."""
    (path,) = release.glob("*.zip")
    changes: dict[str, bytes | None] = {
        "tests/conftest.py": b"",
        "solver/__pycache__/solver.cpython-313.pyc": b"",
        "solver/notes.txt": b"do not forget",
        "solver/solver.py": b"import antigravity\n",
        "LICENSE": None,
    }
    rewrite(path, changes)
    result = check(repository, release, "--platforms", "here")
    assert result.returncode == 1
    for problem in (
        "tests/conftest.py does not belong in it",
        "solver/__pycache__/solver.cpython-313.pyc does not belong in it",
        "solver/notes.txt does not belong in it",
        "solver/solver.py differs from the repository's",
        "LICENSE is missing",
        "wheels/pyusb-1.3.1-py3-none-any.whl is missing",
        "its manifest names other wheels",
        f"index.json: {path.name} has changed since",
    ):
        assert problem in result.stderr


def test_licence_that_does_not_go_with_the_gpl_is_refused(repository: Path, release: Path) -> None:
    """Refuse a wheel whose licence is not known, and take one whose classifier tells it."""
    (path,) = release.glob("*.zip")
    name = "wheels/pyusb-1.3.1-py3-none-any.whl"
    for line in ("License: Proprietary", "Classifier: Topic :: Games"):
        rewrite(path, {name: wheel(line)})
        result = check(repository, release, "--platforms", "here")
        assert f"{name} is under '" in result.stderr
        assert "not known to go with the GPL" in result.stderr
    rewrite(path, {name: wheel("Classifier: License :: OSI Approved :: MIT License")})
    result = check(repository, release, "--platforms", "here")
    assert "go with the GPL" not in result.stderr
    assert "pyusb-1.3.1-py3-none-any.whl: MIT\n" in result.stdout


def test_platform_that_is_missing_is_named(repository: Path, release: Path) -> None:
    """Ask for a zip of every platform of the manifest, and for none of another version."""
    (release / "tactile_clay-0.0.1-linux_x64.zip").write_bytes(b"")
    result = check(repository, release)
    assert result.returncode == 1
    assert result.stderr.count("there is none in") == 2
    assert "tactile_clay-0.0.1-linux_x64.zip: it is not of this release" in result.stderr
