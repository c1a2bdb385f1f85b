# SPDX-License-Identifier: GPL-3.0-or-later
"""Check that the extension's zips hold what they should and nothing else; exit 1 if not.

Run on the folder that ``tools/extension.py`` fills. Every file beside the wheels must be one of the
repository's own, unaltered; the wheels must be those of the zip's platform, each under a licence
that may be combined with the GPL; the index must tell the zips' true sizes and checksums.
"""

import argparse
import hashlib
import io
import json
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from email.message import Message
from email.parser import HeaderParser
from pathlib import Path
from typing import Any

from extension import MANIFEST, ROOT, BuildError, platform_here, run_tool, wheels_for

# How wheels name licences, and what is meant. All of these may be combined with the GPL, version 3.
LICENSES = {
    "Apache-2.0": "Apache-2.0",
    "BSD": "BSD-3-Clause",
    "BSD License": "BSD-3-Clause",
    "BSD-3-Clause": "BSD-3-Clause",
    "MIT": "MIT",
    "MIT License": "MIT",
    "The MIT License (MIT)": "MIT",
}
# Licence files in wheels of parts that have terms of their own, whatever the wheel says as a whole.
OWN_TERMS = {"cuda", "libmathdx", "nvrtc"}


def source_files(manifest: dict[str, Any]) -> dict[str, Path]:
    """The files that belong into a zip beside manifest and wheels, by their path in it.

    What is not under version control is no part of a release, even where it lies among the sources.
    """
    tracked = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=False
    )
    if tracked.returncode == 0:
        names = [name for name in tracked.stdout.split("\0") if name]
    else:
        names = [
            path.relative_to(ROOT).as_posix()
            for path in ROOT.rglob("*")
            if path.is_file() and path.suffix != ".pyc"
        ]
    wanted = tuple(
        pattern.removeprefix("!/")
        for pattern in manifest["build"]["paths_exclude_pattern"]
        if pattern.startswith("!/")
    )
    return {
        name: ROOT / name
        for name in names
        if any(name == part or (part.endswith("/") and name.startswith(part)) for part in wanted)
    }


def license_of(wheel: bytes) -> tuple[str, list[str]]:
    """What a wheel says of its licence.

    Returns:
        Its own words, and the names of its parts that have terms of their own.
    """
    with zipfile.ZipFile(io.BytesIO(wheel)) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        table: Message = HeaderParser().parsestr(archive.read(metadata).decode("utf-8"))
    classifiers = [
        line.rpartition(" :: ")[2]
        for line in table.get_all("Classifier", [])
        if line.startswith("License :: ")
    ]
    said = table["License-Expression"] or table["License"] or " and ".join(classifiers)
    parts = {Path(name).stem.partition("-")[0] for name in names if "/licenses/" in name}
    # Some give the whole text; its first line is the name.
    return (said or "no licence").splitlines()[0].strip(), sorted(parts & OWN_TERMS)


def check_zip(path: Path, platform: str, manifest: dict[str, Any]) -> Iterator[str]:
    """Say what is wrong with one zip; print what wheels it holds."""
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile) as error:
        yield f"it cannot be read ({error})"
        return
    with archive:
        if broken := archive.testzip():
            yield f"{broken} in it is damaged"
            return
        names = {name for name in archive.namelist() if not name.endswith("/")}
        sources = source_files(manifest)
        wheels = {f"wheels/{name}" for name in wheels_for(manifest, platform)}
        for name in sorted((sources.keys() | wheels | {MANIFEST}) - names):
            yield f"{name} is missing"
        for name in sorted(names - sources.keys() - wheels - {MANIFEST}):
            yield f"{name} does not belong in it, or is not under version control"
        for name in sorted(names & sources.keys() - {MANIFEST}):
            if archive.read(name) != sources[name].read_bytes():
                yield f"{name} differs from the repository's"
        if MANIFEST in names:
            packed = tomllib.loads(archive.read(MANIFEST).decode("utf-8"))
            generated = packed.get("build", {}).get("generated", {})
            if packed["version"] != manifest["version"]:
                yield f"its version is {packed['version']}, not {manifest['version']}"
            if generated.get("platforms") != [platform]:
                yield f"its manifest is for {generated.get('platforms')}, not {platform}"
            if {f"./{name}" for name in wheels} != set(generated.get("wheels", [])):
                yield "its manifest names other wheels"
        for name in sorted(wheels & names):
            said, own_terms = license_of(archive.read(name))
            if said not in LICENSES:
                yield f"{name} is under {said!r}, which is not known to go with the GPL"
                continue
            note = f"; parts under terms of their own: {', '.join(own_terms)}" if own_terms else ""
            print(f"    {Path(name).name}: {LICENSES[said]}{note}")
    try:
        run_tool("validate", str(path))
    except BuildError as error:
        yield str(error)


def check_index(folder: Path, zips: list[Path]) -> Iterator[str]:
    """Say what is wrong with ``index.json``, from which Blender installs and updates."""
    try:
        entries = json.loads((folder / "index.json").read_text(encoding="utf-8"))["data"]
    except (OSError, ValueError, KeyError) as error:
        yield f"it cannot be read ({error})"
        return
    by_name = {entry["archive_url"].removeprefix("./"): entry for entry in entries}
    for name in sorted(by_name.keys() ^ {path.name for path in zips}):
        yield f"{name} is {'not in the folder' if name in by_name else 'missing'}"
    for path in zips:
        if entry := by_name.get(path.name):
            checksum = f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
            if (entry["archive_size"], entry["archive_hash"]) != (path.stat().st_size, checksum):
                yield f"{path.name} has changed since"


def main() -> int:
    """Check what the command line names and say what is wrong.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description="Check the extension's zips before a release.")
    parser.add_argument("folder", type=Path, help="folder with the zips and their index")
    parser.add_argument(
        "--platforms",
        nargs="+",
        default=[],
        metavar="PLATFORM",
        help="only these, such as linux-x64; 'here' is this machine's (default: all)",
    )
    options = parser.parse_args()
    manifest = tomllib.loads((ROOT / MANIFEST).read_text(encoding="utf-8"))
    platforms = options.platforms or manifest["platforms"]
    platforms = [platform_here() if name == "here" else name for name in platforms]
    problems: list[str] = []
    zips: list[Path] = []
    for platform in platforms:
        name = f"{manifest['id']}-{manifest['version']}-{platform.replace('-', '_')}.zip"
        path = options.folder / name
        if not path.is_file():
            problems.append(f"{name}: there is none in {options.folder}. Run `make extension`.")
            continue
        zips.append(path)
        print(f"{name}: {path.stat().st_size / 1e6:.1f} MB")
        problems += [f"{name}: {problem}" for problem in check_zip(path, platform, manifest)]
    problems += [f"index.json: {problem}" for problem in check_index(options.folder, zips)]
    strangers = {path.name for path in options.folder.glob("*.zip")} - {path.name for path in zips}
    if not options.platforms:
        problems += [f"{name}: it is not of this release" for name in sorted(strangers)]
    for problem in problems:
        print(f"release: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
