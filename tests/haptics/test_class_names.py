# SPDX-License-Identifier: GPL-3.0-or-later
"""Names in the haptics package, in Python and in C++."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

CPP_CLASS = re.compile(r"^(?:class|struct) (\w+)[^;]*\{", re.MULTILINE)


def classes(path: Path) -> Iterator[str]:
    """Names of the classes that a source file defines."""
    text = path.read_text("utf-8")
    if path.suffix == ".py":
        yield from (
            node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ClassDef)
        )
    else:
        yield from CPP_CLASS.findall(text)


def aliases(path: Path) -> Iterator[tuple[str, str]]:
    """Type aliases at the top of a Python file, with what each means."""
    for node in ast.parse(path.read_text("utf-8")).body:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and isinstance(node.value, ast.Subscript)
        ):
            yield node.targets[0].id, ast.unparse(node.value)


def test_a_class_name_means_one_thing(repository: Path) -> None:
    """Reuse no class name of haptics, in haptics itself or elsewhere in the project."""
    places: dict[str, list[str]] = defaultdict(list)
    for part in ("haptics", "solver", "clay_addon"):
        for suffix in (".py", ".hpp", ".cpp"):
            for path in sorted((repository / part).rglob(f"*{suffix}")):
                for name in classes(path):
                    places[name].append(path.relative_to(repository).as_posix())
    assert {"TransducerArray", "Foci", "FociMessage"} <= set(places)
    assert {
        name: found
        for name, found in places.items()
        if len(found) > 1 and any(path.startswith("haptics/") for path in found)
    } == {}


def test_a_type_alias_means_one_thing(repository: Path) -> None:
    """Give a type alias the same meaning in every file of haptics, and no class its name."""
    meanings: dict[str, set[str]] = defaultdict(set)
    names: set[str] = set()
    for path in (repository / "haptics").rglob("*"):
        if path.suffix == ".py":
            for name, meaning in aliases(path):
                meanings[name].add(meaning)
        if path.suffix in (".py", ".hpp", ".cpp"):
            names.update(classes(path))
    assert meanings["Real"] == {"NDArray[np.float64]"}
    assert {name: found for name, found in meanings.items() if len(found) > 1} == {}
    assert names.isdisjoint(meanings)
