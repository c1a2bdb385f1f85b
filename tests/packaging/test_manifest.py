# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's manifest is consistent with the project."""

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
    """The ``project`` table of pyproject.toml."""
    tables: dict[str, Any] = tomllib.loads((repository / "pyproject.toml").read_text("utf-8"))
    project: dict[str, Any] = tables["project"]
    return project


def test_version_is_the_same_everywhere(
    repository: Path, manifest: dict[str, Any], project: dict[str, Any]
) -> None:
    """Extension, Python package and the newest entry of the changelog have the same version."""
    changes = (repository / "CHANGELOG.md").read_text("utf-8")
    newest = re.search(r"^## \[(\d+\.\d+\.\d+)\]", changes, flags=re.MULTILINE)
    assert newest is not None
    assert manifest["version"] == project["version"] == newest[1]


@pytest.mark.parametrize("tag", ["manylinux", "win_amd64", "macosx"])
def test_each_platform_bundles_the_dependencies(
    tag: str, manifest: dict[str, Any], project: dict[str, Any]
) -> None:
    """Each dependency except numpy, which is part of Blender, has one wheel of a valid version."""
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


def test_wheels_support_every_python(manifest: dict[str, Any]) -> None:
    """No wheel requires a specific Python, since Blender versions differ in theirs."""
    for path in manifest["wheels"]:
        _, _, _, tags = parse_wheel_filename(Path(path).name)
        assert all(tag.abi in {"abi3", "none"} for tag in tags), path
