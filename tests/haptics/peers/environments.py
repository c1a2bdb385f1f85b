# SPDX-License-Identifier: GPL-3.0-or-later
"""Creates environments of acoustic packages for comparison, under build/peers."""

from __future__ import annotations

import sys
from pathlib import Path

from tactile_clay.tests.bench.peers import Peer, make_environment

ROOT = Path(__file__).resolve().parents[3]
PEERS = {
    "levitate": Peer("levitate", ("levitate==3.0.0", "scipy<1.15"), "levitate_field.py"),
    "autd3": Peer(
        "autd3",
        (
            "autd3==0.12.0",
            "autd3-pattern-holo==0.12.0",
            "autd3-emulator==0.12.0",
        ),
        "autd3_field.py",
    ),
}


def ready(peer: Peer, repository: Path) -> Path | None:
    """The Python of a peer's environment; None if it does not exist."""
    home = repository / "build" / "peers" / peer.environment
    return home / "bin" / "python" if (home / "installed.stamp").exists() else None


def main() -> int:
    """Create all environments, and report those that cannot be created."""
    failed = 0
    for peer in PEERS.values():
        try:
            make_environment(peer, ROOT / "build" / "peers")
        except RuntimeError as error:
            print(f"{peer.name} {error}")
            failed += 1
    return failed


if __name__ == "__main__":
    sys.exit(main())
