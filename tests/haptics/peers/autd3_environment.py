# SPDX-License-Identifier: GPL-3.0-or-later
"""AUTD3's own packages, in a separate environment under build/peers.

Run as a module, it creates the environment from the package index.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from tactile_clay.tests.bench.peers import Peer, make_environment

FOLDER = Path(__file__).resolve().parents[3] / "build" / "peers"
NAMES = ("autd3-modulation", "autd3", "autd3-pattern", "autd3-emulator")
AUTD3 = Peer(
    "AUTD3",
    tuple(f"{name}==0.12.0" for name in NAMES),
    "",
)


def find_packages() -> str | None:
    """Folder of the packages for ``sys.path``; empty if already on it, None if not installed."""
    if importlib.util.find_spec("autd3") is not None:
        return ""
    home = FOLDER / AUTD3.environment
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = home / "lib" / version / "site-packages"
    made = (home / "installed.stamp").exists() and (packages / "autd3").is_dir()
    return str(packages) if made else None


if __name__ == "__main__":
    print(f"{make_environment(AUTD3, FOLDER)} is ready.")
