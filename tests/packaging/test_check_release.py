# SPDX-License-Identifier: GPL-3.0-or-later
"""The check before a release accepts built zips and reports problems."""

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
    """Replace, add or remove (None) files in a zip."""
    with zipfile.ZipFile(path) as archive:
        files: dict[str, bytes | None] = {
            name: archive.read(name) for name in archive.namelist() if not name.endswith("/")
        }
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (files | changes).items():
            if content is not None:
                archive.writestr(name, content)


def wheel(license_line: str) -> bytes:
    """A wheel that contains only a license."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        text = f"Metadata-Version: 2.4\nName: pyusb\nVersion: 1.3.1\n{license_line}\n"
        archive.writestr("pyusb-1.3.1.dist-info/METADATA", text)
    return content.getvalue()


@pytest.fixture
def release(extension_zip_without_wheels: Path, tmp_path: Path) -> Path:
    """A folder with a copy of the zip for this machine, without wheels, and its index."""
    for name in (extension_zip_without_wheels.name, "index.json"):
        shutil.copy(extension_zip_without_wheels.parent / name, tmp_path)
    return tmp_path


def test_complete_release_passes(repository: Path, request: pytest.FixtureRequest) -> None:
    """The zip with its wheels passes, and the license of each wheel is listed."""
    if not list((repository / "wheels").glob("warp_lang-*.whl")):
        pytest.skip("needs the wheels: run `make extension` once")
    folder = request.getfixturevalue("extension_zip").parent
    result = check(repository, folder, "--platforms", "here")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.count(".whl: ") == 6
    assert "trimesh-5.2.0-py3-none-any.whl: MIT\n" in result.stdout


def test_foreign_altered_and_missing_files_are_named(repository: Path, release: Path) -> None:
    """Tests, caches, altered files, missing files and missing wheels are named."""
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
        "tests/conftest.py does not belong in a release",
        "solver/__pycache__/solver.cpython-313.pyc does not belong in a release",
        "solver/notes.txt does not belong in a release",
        "solver/solver.py differs from the repository",
        "LICENSE is missing",
        "wheels/pyusb-1.3.1-py3-none-any.whl is missing",
        "the manifest lists other wheels",
        f"index.json: {path.name} has changed since it was indexed",
    ):
        assert problem in result.stderr


def test_license_incompatible_with_the_gpl_is_refused(repository: Path, release: Path) -> None:
    """A wheel with an unknown license is refused; a classifier may state the license."""
    (path,) = release.glob("*.zip")
    name = "wheels/pyusb-1.3.1-py3-none-any.whl"
    for line in ("License: Proprietary", "Classifier: Topic :: Games"):
        rewrite(path, {name: wheel(line)})
        result = check(repository, release, "--platforms", "here")
        assert f"{name} is under '" in result.stderr
        assert "not known to be compatible with the GPL" in result.stderr
    rewrite(path, {name: wheel("Classifier: License :: OSI Approved :: MIT License")})
    result = check(repository, release, "--platforms", "here")
    assert "compatible with the GPL" not in result.stderr
    assert "pyusb-1.3.1-py3-none-any.whl: MIT\n" in result.stdout


def test_missing_platform_is_named(repository: Path, release: Path) -> None:
    """Zips for all platforms of the manifest are required; those of other versions are refused."""
    (release / "tactile_clay-0.0.1-linux_x64.zip").write_bytes(b"")
    result = check(repository, release)
    assert result.returncode == 1
    assert result.stderr.count("not found in") == 2
    assert "tactile_clay-0.0.1-linux_x64.zip: not part of this release" in result.stderr
