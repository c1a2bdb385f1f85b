# SPDX-License-Identifier: GPL-3.0-or-later
"""The public names of the solver."""

import subprocess
import sys

import pytest

from tactile_clay import solver


@pytest.mark.parametrize("name", solver.__all__)
def test_every_public_name_resolves(name: str) -> None:
    """Resolve to an object of that name, defined in the solver."""
    value = getattr(solver, name)
    if callable(value):
        assert value.__name__ == name
        assert value.__module__.startswith("tactile_clay.solver.")


def test_names_loaded_on_use_are_public() -> None:
    """List every name that is loaded on first use in ``__all__``, and no name twice."""
    assert set(solver._LOADED_ON_USE) <= set(solver.__all__)
    assert len(set(solver.__all__)) == len(solver.__all__)


def test_star_import_gives_all_names() -> None:
    """Import all names at once, in a process that has loaded none of them."""
    code = (
        "from tactile_clay.solver import *\n"
        "import tactile_clay.solver as s\n"
        "missing = [n for n in s.__all__ if n not in globals()]\n"
        "assert not missing, missing\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_an_unknown_name_is_an_attribute_error() -> None:
    """Raise an error that names the unknown attribute."""
    with pytest.raises(AttributeError, match="no_such_name"):
        solver.no_such_name  # noqa: B018
