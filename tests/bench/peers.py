# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the same press in other engines and in Tactile Clay, and compares error and cost.

Installs each engine from the package index into its own Python environment under build/peers, and
writes build/bench/peers.json and peers.md. Each runs on one thread, so that waiting does not count
as processor time.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from .peer_scene import PeerMeasures, PeerScene, make_scene, measure

FOLDER = Path(__file__).resolve().parent
TIME_LIMIT = 1500.0
"""Seconds after which an engine is aborted."""


@dataclass(frozen=True)
class Peer:
    """An engine and how to run it."""

    name: str
    """Name in the table."""
    requirements: tuple[str, ...]
    """Packages for pip to install."""
    script: str
    """Script that runs the scene in the engine's environment."""
    note: str = ""
    """What readers of its figures must know."""
    preload: tuple[str, ...] = ()
    """Libraries to load first on Linux."""

    @property
    def environment(self) -> str:
        """Folder name of its environment."""
        return self.requirements[0].partition("=")[0]


PEERS = (
    Peer(
        "Newton, implicit MPM",
        ("newton",),
        "peer_newton.py",
        note="set up like the mud of its own example, one step per frame",
    ),
    Peer(
        "Taichi, MLS-MPM",
        ("taichi",),
        "peer_taichi.py",
        note="explicit, von Mises by return mapping; cells of two spacings, so the ball's radius "
        "is 1.2 cells",
    ),
    Peer(
        "SPlisHSPlasH, PBF",
        ("pysplishsplash",),
        "peer_splishsplash.py",
        note="a viscous fluid, as it has no clay; its Python interface reports no force",
        # The wheel bundles its own libGLdispatch; the system's libGL must be loaded before it.
        preload=("libGL.so.1",),
    ),
)


@dataclass(frozen=True)
class Entry:
    """The result of an engine."""

    name: str
    """Name of the engine."""
    versions: dict[str, str]
    """Versions of the packages installed for it."""
    note: str
    """What readers of its figures must know."""
    measures: PeerMeasures | None
    """Measurements; None if it failed."""
    failure: str = ""
    """Why it failed."""


def make_environment(peer: Peer, folder: Path) -> Path:
    """Make the engine's environment unless it exists.

    Returns:
        Path of its Python.

    Raises:
        RuntimeError: Installation failed; the message is the end of its output.
    """
    home = folder / peer.environment
    python = home / "bin" / "python"
    stamp = home / "installed.stamp"
    wanted = "\n".join((sys.version, *peer.requirements))
    if stamp.exists() and stamp.read_text(encoding="utf-8") == wanted:
        return python
    print(f"  making {home}", flush=True)
    install = (str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    commands: tuple[Sequence[str], ...] = (
        (sys.executable, "-m", "venv", "--clear", str(home)),
        (*install, "numpy", *peer.requirements),
    )
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"cannot be installed: {done.stderr.strip()[-300:]}")
    stamp.write_text(wanted, encoding="utf-8")
    return python


def list_versions(python: Path) -> dict[str, str]:
    """Versions of all packages in an environment."""
    text = subprocess.run(
        (str(python), "-m", "pip", "list", "--format=json", "--disable-pip-version-check"),
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    return {item["name"]: item["version"] for item in json.loads(text) if item["name"] != "pip"}


def run_command(
    command: Sequence[str], scene: PeerScene, variables: dict[str, str]
) -> PeerMeasures:
    """Run an engine on the scene, passed to it as a file.

    Raises:
        RuntimeError: It failed; the message is the end of its output.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene_path, result_path = Path(folder, "scene.npz"), Path(folder, "result.npz")
        np.savez(scene_path, **scene.arrays())
        full = [*command]
        full[full.index("SCENE")] = str(scene_path)
        full[full.index("RESULT")] = str(result_path)
        environment = os.environ | {"OMP_NUM_THREADS": "1"} | variables
        try:
            done = subprocess.run(
                full,
                capture_output=True,
                text=True,
                check=False,
                timeout=TIME_LIMIT,
                env=environment,
            )
        except subprocess.TimeoutExpired as error:
            raise RuntimeError(f"took longer than {TIME_LIMIT:.0f} s") from error
        if not result_path.exists():
            output = (done.stderr.strip() or done.stdout.strip())[-300:]
            raise RuntimeError(f"ended with {done.returncode}: {output}")
        return measure(scene, dict(np.load(result_path)))


def run_peer(peer: Peer, scene: PeerScene, folder: Path) -> Entry:
    """Install and run an engine; a failure becomes part of the entry."""
    versions: dict[str, str] = {}
    try:
        python = make_environment(peer, folder)
        versions = list_versions(python)
        command = (str(python), str(FOLDER / peer.script), "SCENE", "RESULT")
        variables = {"PYTHONPATH": ""}
        if peer.preload and sys.platform == "linux":
            variables["LD_PRELOAD"] = ":".join(peer.preload)
        measures = run_command(command, scene, variables)
    except (RuntimeError, OSError) as error:
        return Entry(peer.name, versions, peer.note, None, str(error))
    return Entry(peer.name, versions, peer.note, measures)


def run_own(scene: PeerScene) -> Entry:
    """Run the scene in Tactile Clay, in its own process like the others."""
    module = "tactile_clay.tests.bench.peer_own"
    try:
        measures = run_command((sys.executable, "-m", module, "SCENE", "RESULT"), scene, {})
    except RuntimeError as error:
        return Entry("Tactile Clay", {}, "", None, str(error))
    return Entry("Tactile Clay", list_versions(Path(sys.executable)), "", measures)


COLUMNS: tuple[tuple[str, Callable[[PeerMeasures], str]], ...] = (
    ("core-µs per particle and frame", lambda m: f"{m.core_microseconds:.1f}"),
    ("ms per frame", lambda m: f"{m.wall_milliseconds:.0f}"),
    ("drift at rest, spacings", lambda m: f"{m.drift:.2g}"),
    ("force moving / theory", lambda m: _or_dash(m.force_moving)),
    ("force held / theory", lambda m: _or_dash(m.force_held)),
    ("dent / depth", lambda m: f"{m.dent:.2f}"),
    ("spring-back", lambda m: f"{m.spring_back:.0%}"),
    ("density change", lambda m: f"{m.compression:+.1%}"),
    ("height lost", lambda m: f"{m.height_lost:.1%}"),
)


def _or_dash(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "—"


def table(entries: Sequence[Entry]) -> list[str]:
    """The comparison, in Markdown."""
    lines = [f"| engine | {' | '.join(title for title, _ in COLUMNS)} | times ours |"]
    lines.append("|---" * (len(COLUMNS) + 2) + "|")
    own = next((e.measures for e in entries if e.name == "Tactile Clay" and e.measures), None)
    for entry in entries:
        if entry.measures is None:
            lines.append(f"| {entry.name} | {entry.failure}" + " |" * (len(COLUMNS) + 1))
            continue
        cells = [show(entry.measures) for _, show in COLUMNS]
        ratio = entry.measures.core_microseconds / own.core_microseconds if own else math.nan
        lines.append(f"| {entry.name} | {' | '.join(cells)} | {_or_dash(ratio)} |")
    return lines


def write(entries: Sequence[Entry], scene: PeerScene, folder: Path) -> None:
    """Write peers.json and peers.md."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        f"A ball of 12 mm radius is pressed 12 mm deep into {len(scene.points)} particles of clay "
        "(τ_y 5 kPa, G 100 kPa, K 300 kPa, 1700 kg/m³, no viscosity) at 90 mm/s, held for a third "
        "of a second and taken away. Theory is the middle of 5.7 to 6.05 τ_y A. One thread each; "
        "medians over the frames of press and hold. The density change is that of the mean "
        "over all particles, so it decreases when a block spreads and its surface grows.",
        "",
        *table(entries),
        "",
        *(f"- {e.name}: {e.note}." for e in entries if e.note),
        "",
        "Versions: "
        + "; ".join(
            f"{e.name}: " + ", ".join(f"{k} {v}" for k, v in e.versions.items())
            for e in entries
            if e.name != "Tactile Clay" and e.versions
        )
        + ".",
    ]
    (folder / "peers.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    data = [
        {
            **asdict(e),
            "measures": None
            if e.measures is None
            else {k: v if math.isfinite(v) else None for k, v in asdict(e.measures).items()},
        }
        for e in entries
    ]
    text = json.dumps({"particles": len(scene.points), "engines": data}, indent=2)
    (folder / "peers.json").write_text(text + "\n", encoding="utf-8")


def main() -> None:
    """Run every engine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/bench"))
    parser.add_argument("--environments", type=Path, default=Path("build/peers"))
    parser.add_argument("--only", help="run only engines whose name contains this")
    parser.add_argument("--counts", type=int, default=16, help="particles along the block's edge")
    options = parser.parse_args()
    scene = make_scene(options.counts)
    print(f"Tactile Clay, {len(scene.points)} particles", flush=True)
    entries = [run_own(scene)]
    for peer in PEERS:
        if options.only and options.only.lower() not in peer.name.lower():
            continue
        print(peer.name, flush=True)
        entries.append(run_peer(peer, scene, options.environments.resolve()))
        if entries[-1].failure:
            print(f"  {entries[-1].failure}", flush=True)
    write(entries, scene, options.output)
    print("\n".join(table(entries)))
    print(f"Wrote {options.output / 'peers.json'} and peers.md.")


if __name__ == "__main__":
    main()
