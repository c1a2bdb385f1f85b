# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts the array server or its guard in a process of its own, wherever this package lies.

Run as a script: inside Blender the package has another name than in a Python environment, and a
process started from there knows neither. So it is loaded from its folder under the usual name.
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
    part: str, words: Sequence[str], *, stdout: IO[Any] | int | None = None
) -> subprocess.Popen[bytes]:
    """Start a part in a new process whose standard input is a pipe from here.

    The pipe ends when this process does, however it ends, and that tells the new one.

    Args:
        part: ``server`` or ``guard``.
        words: Its command line.
        stdout: Where its standard output goes.

    Raises:
        OSError: The process cannot be started.
    """
    # Blender keeps numpy and what the extension brings along where only its own Python looks.
    path = os.pathsep.join(entry for entry in sys.path if entry)
    return subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).resolve()), part, *words],
        stdin=subprocess.PIPE,
        stdout=stdout,
        bufsize=0,
        env=os.environ | {"PYTHONPATH": path},
        # A Ctrl-C in the terminal is for the one that was started there, which then tells the
        # others.
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
