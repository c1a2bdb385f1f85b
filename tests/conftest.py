# SPDX-License-Identifier: GPL-3.0-or-later
"""What all tests share: the repository, and the extension's zip built from it."""

import subprocess
import sys
from pathlib import Path

import pytest

import tactile_clay

ROOT = Path(__file__).resolve().parent.parent


def pytest_configure() -> None:
    """Refuse to test another copy of the package than the one beside these tests."""
    package = Path(str(tactile_clay.__file__)).resolve().parent
    if package != ROOT:
        raise pytest.UsageError(
            f"tactile_clay is imported from {package}, these tests are of {ROOT}: use `make test`."
        )


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root."""
    return ROOT


def build_extension(output: Path, *options: str) -> Path:
    """Build this machine's zip into a folder.

    Returns:
        The zip.
    """
    command = [sys.executable, str(ROOT / "tools" / "extension.py")]
    command += ["--platforms", "here", "--output", str(output), *options]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    (path,) = output.glob("*.zip")
    return path


@pytest.fixture(scope="session")
def extension_zip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """This machine's zip as a person would install it, wheels and all, built from these sources."""
    return build_extension(tmp_path_factory.mktemp("extension"))


@pytest.fixture(scope="session")
def extension_zip_without_wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """This machine's zip without its wheels: no download, and an extension that lacks Warp."""
    return build_extension(tmp_path_factory.mktemp("extension"), "--without-wheels")
