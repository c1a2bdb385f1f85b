# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules that keep the sources easy to navigate."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PARTS = ("clay_addon", "haptics", "solver")
MAX_FILES = 15
"""Maximum number of Python files in a folder, including __init__.py."""
MAX_LINES = 450
"""Maximum number of lines in a file."""
PRINTING = (
    "clay_addon/command/",
    "clay_addon/core/tracking/command.py",
    "clay_addon/core/tracking/sources/",
    "haptics/array_server/command.py",
    "haptics/array_server/guard.py",
)
"""Programs, which print to a terminal."""
OLD_BOUNDS = re.compile(
    r"^\s*_?(MOST|LEAST|FEWEST|LARGEST|SMALLEST|LONGEST|SHORTEST|FASTEST|MAXIMUM|MINIMUM)_\w+"
    r" *[:=,]",
    re.MULTILINE,
)


def sources(repository: Path) -> Iterator[Path]:
    """Python files of the product."""
    for part in PARTS:
        yield from sorted((repository / part).rglob("*.py"))


def test_every_folder_is_a_documented_package(repository: Path) -> None:
    """Each folder has an __init__.py with a docstring, and not too many files."""
    for part in PARTS:
        for folder in [repository / part, *(repository / part).rglob("*")]:
            files = list(folder.glob("*.py")) if folder.is_dir() else []
            if not files:
                continue
            init = folder / "__init__.py"
            assert init in files, f"{folder} has no __init__.py"
            assert ast.get_docstring(ast.parse(init.read_text("utf-8"))), f"{init} has no docstring"
            assert len(files) <= MAX_FILES, f"{folder} has {len(files)} files"


def test_no_file_is_too_long(repository: Path) -> None:
    """No file has more than `MAX_LINES` lines."""
    long = {
        str(path.relative_to(repository)): lines
        for path in sources(repository)
        if (lines := len(path.read_text("utf-8").splitlines())) > MAX_LINES
    }
    assert long == {}


def test_state_has_owners(repository: Path) -> None:
    """There is no global statement: state belongs to an object."""
    found = [
        f"{path.relative_to(repository)}:{node.lineno}"
        for path in sources(repository)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Global)
    ]
    assert found == []


def test_only_programs_print(repository: Path) -> None:
    """Only programs print; libraries use logging."""
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
    """Every error of the project derives from TactileClayError, directly or indirectly."""
    others = [
        f"{path.relative_to(repository)}: {node.name}"
        for path in sources(repository)
        # Runs in a separate environment, without the project.
        if path.name != "mediapipe_worker.py"
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef)
        and node.name.endswith("Error")
        and node.name != "TactileClayError"
        and not any(
            isinstance(base, ast.Name) and base.id.endswith("Error") for base in node.bases[:1]
        )
    ]
    assert others == []


@pytest.mark.parametrize("pattern", [r"\bscale_length\b"], ids=["units"])
def test_units_are_converted_in_one_place(repository: Path, pattern: str) -> None:
    """Only one module, and the view passed to core, reads the length of a Blender unit."""
    allowed = {"clay_addon/base/units.py", "clay_addon/core/brush/view_region.py"}
    found = {
        path.relative_to(repository).as_posix()
        for path in sources(repository)
        if re.search(pattern, path.read_text("utf-8"))
    }
    assert found <= allowed


def test_bounds_are_named_consistently(repository: Path) -> None:
    """Names of bounds begin with MAX_ or MIN_."""
    found = [
        f"{path.relative_to(repository)}: {match[0].strip()}"
        for path in sources(repository)
        for match in OLD_BOUNDS.finditer(path.read_text("utf-8"))
    ]
    assert found == []
