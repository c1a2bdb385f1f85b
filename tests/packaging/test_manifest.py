# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's manifest agrees with the project and obeys the format's limits."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename


@pytest.fixture(scope="module")
def manifest(repository: Path) -> dict[str, Any]:
    """The parsed manifest."""
    return tomllib.loads((repository / "blender_manifest.toml").read_text("utf-8"))


@pytest.fixture(scope="module")
def project(repository: Path) -> dict[str, Any]:
    """The project's table of pyproject.toml."""
    tables: dict[str, Any] = tomllib.loads((repository / "pyproject.toml").read_text("utf-8"))
    project: dict[str, Any] = tables["project"]
    return project


def test_version_is_the_same_everywhere(
    repository: Path, manifest: dict[str, Any], project: dict[str, Any]
) -> None:
    """Give the extension, the Python package and the newest entry of the changes one version."""
    changes = (repository / "CHANGELOG.md").read_text("utf-8")
    newest = re.search(r"^## \[(\d+\.\d+\.\d+)\]", changes, flags=re.MULTILINE)
    assert newest is not None
    assert manifest["version"] == project["version"] == newest[1]


@pytest.mark.parametrize("tag", ["manylinux", "win_amd64", "macosx"])
def test_each_platform_bundles_what_the_project_needs(
    tag: str, manifest: dict[str, Any], project: dict[str, Any]
) -> None:
    """Bundle a wheel of every dependency but numpy, which Blender brings, as new as asked for."""
    wheels = [parse_wheel_filename(Path(path).name) for path in manifest["wheels"]]
    needed = [Requirement(text) for text in project["dependencies"]]
    for requirement in needed:
        if requirement.name == "numpy":
            continue
        versions = [
            version
            for name, version, _, tags in wheels
            if name == canonicalize_name(requirement.name)
            and any(item.platform == "any" or item.platform.startswith(tag) for item in tags)
        ]
        assert len(versions) == 1, f"{requirement.name} on {tag}"
        assert versions[0] in requirement.specifier


def test_wheels_serve_every_python(manifest: dict[str, Any]) -> None:
    """Bundle no wheel that is bound to one Python, since each Blender has another."""
    for path in manifest["wheels"]:
        _, _, _, tags = parse_wheel_filename(Path(path).name)
        assert all(tag.abi in {"abi3", "none"} for tag in tags), path
