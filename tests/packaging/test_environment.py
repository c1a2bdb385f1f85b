# SPDX-License-Identifier: GPL-3.0-or-later
"""The script that creates the environment explains problems and deletes nothing else."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest


@pytest.fixture
def checkout(repository: Path, tmp_path: Path) -> Path:
    """A separate folder with the files that the script needs."""
    folder = tmp_path / "a clone with spaces"
    (folder / "tools").mkdir(parents=True)
    shutil.copy(repository / "tools" / "environment.sh", folder / "tools")
    shutil.copy(repository / "pyproject.toml", folder)
    return folder


def run_script(
    checkout: Path, *arguments: str, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run the script with additional environment variables."""
    return subprocess.run(
        ["sh", str(checkout / "tools" / "environment.sh"), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | variables,
    )


def make_program(path: Path, text: str) -> Path:
    """Write an executable shell script."""
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_missing_override_is_named(checkout: Path) -> None:
    """The message names a PYTHON that does not exist."""
    result = run_script(checkout, ".venv", PYTHON="/nowhere/python3.13")
    assert result.returncode != 0
    assert "/nowhere/python3.13" in result.stderr
    assert not (checkout / ".venv").exists()


def test_unusable_override_is_explained(checkout: Path) -> None:
    """The message contains the output of a Python that cannot create environments."""
    python = make_program(checkout / "python", "echo no module named ensurepip; exit 1")
    result = run_script(checkout, ".venv", PYTHON=str(python))
    assert result.returncode != 0
    assert "no module named ensurepip" in result.stderr
    assert "3.13" in result.stderr
    assert "3.11" in result.stderr


def test_broken_shim_is_skipped(checkout: Path) -> None:
    """A shim in the PATH that does not run is skipped."""
    folder = checkout / "shims"
    folder.mkdir()
    make_program(folder / "python3.10", "echo 'pyenv: python3.10: command not found' >&2; exit 127")
    real = checkout / "real"
    real.mkdir()
    make_program(real / "python3.10", "echo 3.10 /opt/true/python3.10")
    path = f"{folder}{os.pathsep}{real}{os.pathsep}{os.environ['PATH']}"
    result = run_script(checkout, "--find", "3.10", PATH=path)
    assert result.stdout.strip() == "/opt/true/python3.10"


def test_missing_version_is_not_found(checkout: Path) -> None:
    """If no Python has the version, the script fails and prints nothing."""
    result = run_script(checkout, "--find", "3.99")
    assert result.returncode == 1
    assert result.stdout == ""


def test_folder_of_another_kind_is_left_alone(checkout: Path) -> None:
    """A folder that is not an environment is not replaced."""
    folder = checkout / "letters"
    folder.mkdir()
    (folder / "to-grandmother.txt").write_text("dear grandmother")
    python = make_program(checkout / "python", f'echo "3.13 {checkout}/python"')
    result = run_script(checkout, "letters", PYTHON=str(python))
    assert result.returncode != 0
    assert "letters" in result.stderr
    assert (folder / "to-grandmother.txt").read_text() == "dear grandmother"
