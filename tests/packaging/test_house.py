# SPDX-License-Identifier: GPL-3.0-or-later
"""What keeps the sources a house that one can find one's way in."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PARTS = ("clay_addon", "haptics", "solver")
MAX_FILES = 15
"""Python files in a folder, its face included."""
MAX_LINES = 450
"""Lines in a file: some screens."""
PRINTING = (
    "clay_addon/command/",
    "clay_addon/core/tracking/command.py",
    "clay_addon/core/tracking/sources/",
    "haptics/array_server/command.py",
    "haptics/array_server/guard.py",
)
"""Programs of their own, which speak to a terminal."""
OLD_BOUNDS = re.compile(
    r"^\s*_?(MOST|LEAST|FEWEST|LARGEST|SMALLEST|LONGEST|SHORTEST|FASTEST|MAXIMUM|MINIMUM)_\w+"
    r" *[:=,]",
    re.MULTILINE,
)


def sources(repository: Path) -> Iterator[Path]:
    """The product's Python files."""
    for part in PARTS:
        yield from sorted((repository / part).rglob("*.py"))


def test_every_folder_is_a_package_with_a_subject(repository: Path) -> None:
    """Say in each folder's face what it is about, and keep folders small."""
    for part in PARTS:
        for folder in [repository / part, *(repository / part).rglob("*")]:
            files = list(folder.glob("*.py")) if folder.is_dir() else []
            if not files:
                continue
            face = folder / "__init__.py"
            assert face in files, f"{folder} has no __init__.py"
            assert ast.get_docstring(ast.parse(face.read_text("utf-8"))), f"{face} says nothing"
            assert len(files) <= MAX_FILES, f"{folder} has {len(files)} files"


def test_no_file_is_longer_than_some_screens(repository: Path) -> None:
    """Keep each file readable in one sitting."""
    long = {
        str(path.relative_to(repository)): lines
        for path in sources(repository)
        if (lines := len(path.read_text("utf-8").splitlines())) > MAX_LINES
    }
    assert long == {}


def test_state_has_owners(repository: Path) -> None:
    """Use no global statement: what changes belongs to an object."""
    found = [
        f"{path.relative_to(repository)}:{node.lineno}"
        for path in sources(repository)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Global)
    ]
    assert found == []


def test_only_programs_print(repository: Path) -> None:
    """Log what a library has to say; print only from programs that own their terminal."""
    found = [
        f"{name}:{node.lineno}"
        for path in sources(repository)
        if not (name := path.relative_to(repository).as_posix()).startswith(PRINTING)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert found == []


def test_errors_have_one_base(repository: Path) -> None:
    """Derive every error of the project from TactileClayError, directly or not."""
    strangers = [
        f"{path.relative_to(repository)}: {node.name}"
        for path in sources(repository)
        # Runs in an environment of its own, without the project.
        if path.name != "mediapipe_worker.py"
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef)
        and node.name.endswith("Error")
        and node.name != "TactileClayError"
        and not any(
            isinstance(base, ast.Name) and base.id.endswith("Error") for base in node.bases[:1]
        )
    ]
    assert strangers == []


@pytest.mark.parametrize("pattern", [r"\bscale_length\b"], ids=["units"])
def test_units_are_turned_in_one_place(repository: Path, pattern: str) -> None:
    """Read the length of a Blender unit in one module, and in the view that core is handed."""
    allowed = {"clay_addon/base/units.py", "clay_addon/core/brush/view_region.py"}
    found = {
        path.relative_to(repository).as_posix()
        for path in sources(repository)
        if re.search(pattern, path.read_text("utf-8"))
    }
    assert found <= allowed


def test_bounds_are_named_alike(repository: Path) -> None:
    """Begin the names of bounds with MAX_ or MIN_."""
    found = [
        f"{path.relative_to(repository)}: {match[0].strip()}"
        for path in sources(repository)
        for match in OLD_BOUNDS.finditer(path.read_text("utf-8"))
    ]
    assert found == []
