# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts the array server or its guard in a separate process, wherever the package is installed.

The new process runs this file as a script. It cannot import the package by name, because the name
differs between Blender and a Python environment, so it loads it from its folder as `tactile_clay`.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

_NAME = "tactile_clay"
_PARTS = {"server": "command", "guard": "guard"}


def start_process(
    part: str, arguments: Sequence[str], *, stdout: IO[Any] | int | None = None
) -> subprocess.Popen[bytes]:
    """Start a part in a new process whose standard input is a pipe from this one.

    The pipe closes when this process ends in any way, which tells the new process to end.

    Args:
        part: ``server`` or ``guard``.
        arguments: Its command-line arguments.
        stdout: Where its standard output goes.

    Raises:
        OSError: The process cannot be started.
    """
    # Only Blender's own Python finds numpy and the packages bundled with the extension.
    path = os.pathsep.join(entry for entry in sys.path if entry)
    return subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).resolve()), part, *arguments],
        stdin=subprocess.PIPE,
        stdout=stdout,
        bufsize=0,
        env=os.environ | {"PYTHONPATH": path},
        # A Ctrl-C in the terminal must reach only the program started there, which ends this one.
        start_new_session=True,
    )


def _load_package() -> None:
    root = Path(__file__).resolve().parents[2]
    if _NAME in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(
        _NAME, root / "__init__.py", submodule_search_locations=[str(root)]
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = module
    spec.loader.exec_module(module)


if __name__ == "__main__":
    _load_package()
    part = importlib.import_module(f"{_NAME}.haptics.array_server.{_PARTS[sys.argv[1]]}")
    sys.exit(part.main(sys.argv[2:]))
