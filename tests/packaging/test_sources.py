# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules for all text files of the repository."""

import re
from collections.abc import Iterator
from pathlib import Path

FOLDERS = ("clay_addon", "haptics", "presets", "solver", "tests", "tools", ".ci")
TEXTS = {"", ".js", ".md", ".py", ".sh", ".toml", ".yaml"}
COMMENTS = {".js": "// ", ".py": "# ", ".yaml": "# "}
PERSONAL = re.compile(r"/(?:home|Users)/\w|/root\b|/work/|[a-z]:\\Users|\bpypi\b", re.IGNORECASE)


def text_files(repository: Path) -> Iterator[Path]:
    """Text files of the repository, without built or downloaded ones."""
    for path in repository.iterdir():
        if path.is_file() and path.suffix in TEXTS and path.name != ".git":
            yield path
    for folder in FOLDERS:
        for path in (repository / folder).rglob("*"):
            if path.is_file() and path.suffix in TEXTS and "__pycache__" not in path.parts:
                yield path


def test_every_source_file_names_its_license(repository: Path) -> None:
    """Every source file begins with its SPDX line."""
    sources = [path for path in text_files(repository) if path.suffix in COMMENTS]
    assert len(sources) > 10
    header = "SPDX-License-Identifier: GPL-3.0-or-later\n"
    bare = [
        str(path)
        for path in sources
        if not path.read_text("utf-8").startswith(COMMENTS[path.suffix] + header)
    ]
    assert bare == []


def test_no_file_contains_paths_of_one_machine(repository: Path) -> None:
    """No file names a personal folder or package index, so that a clone works everywhere."""
    found = [
        f"{path.relative_to(repository)}:{number}: {line.strip()}"
        for path in text_files(repository)
        if path != Path(__file__)
        for number, line in enumerate(path.read_text("utf-8").splitlines(), start=1)
        if PERSONAL.search(line)
    ]
    assert found == []
