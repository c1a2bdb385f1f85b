# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the packages: pyproject.toml cannot say that the repository's root is a package itself."""

from setuptools import find_packages, setup

NAME = "tactile_clay"
PARTS = find_packages(include=["clay_addon*", "haptics*", "solver*"])

setup(packages=[NAME, *(f"{NAME}.{part}" for part in PARTS)])
