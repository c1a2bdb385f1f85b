# SPDX-License-Identifier: GPL-3.0-or-later
"""Check the contents of the extension's zips before a release; exit 1 if anything is wrong.

Run this on the output folder of ``tools/extension.py``. Besides wheels, each zip must contain
exactly the product's files from the repository, unaltered. The wheels must be those for the zip's
platform, under licenses that are compatible with the GPL. The index must have the actual sizes and
checksums of the zips.
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

# Licenses as named in wheels, with their SPDX identifiers. All are compatible with the GPL 3.
LICENSES = {
    "Apache-2.0": "Apache-2.0",
    "BSD": "BSD-3-Clause",
    "BSD License": "BSD-3-Clause",
    "BSD-3-Clause": "BSD-3-Clause",
    "MIT": "MIT",
    "MIT License": "MIT",
    "The MIT License (MIT)": "MIT",
}
# License files of parts with separate terms, whatever the license of the whole wheel.
SEPARATE_TERMS = {"cuda", "libmathdx", "nvrtc"}


def source_files(manifest: dict[str, Any]) -> dict[str, Path]:
    """The files that belong in a zip besides manifest and wheels, by their path in the zip.

    Files that are not under version control are not part of a release.
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
    included = tuple(
        pattern.removeprefix("!/")
        for pattern in manifest["build"]["paths_exclude_pattern"]
        if pattern.startswith("!/")
    )
    return {
        name: ROOT / name
        for name in names
        if any(name == part or (part.endswith("/") and name.startswith(part)) for part in included)
    }


def license_of(wheel: bytes) -> tuple[str, list[str]]:
    """Read the license of a wheel.

    Returns:
        The license as named in the wheel, and the parts with separate terms.
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
    text = table["License-Expression"] or table["License"] or " and ".join(classifiers)
    parts = {Path(name).stem.partition("-")[0] for name in names if "/licenses/" in name}
    # Some wheels have the whole text, whose first line is the name.
    return (text or "no license").splitlines()[0].strip(), sorted(parts & SEPARATE_TERMS)


def check_zip(path: Path, platform: str, manifest: dict[str, Any]) -> Iterator[str]:
    """Yield problems of a zip, and print its wheels."""
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile) as error:
        yield f"cannot be read ({error})"
        return
    with archive:
        if damaged := archive.testzip():
            yield f"{damaged} is damaged"
            return
        names = {name for name in archive.namelist() if not name.endswith("/")}
        sources = source_files(manifest)
        wheels = {f"wheels/{name}" for name in wheels_for(manifest, platform)}
        for name in sorted((sources.keys() | wheels | {MANIFEST}) - names):
            yield f"{name} is missing"
        for name in sorted(names - sources.keys() - wheels - {MANIFEST}):
            yield f"{name} does not belong in a release, or is not under version control"
        for name in sorted(names & sources.keys() - {MANIFEST}):
            if archive.read(name) != sources[name].read_bytes():
                yield f"{name} differs from the repository"
        if MANIFEST in names:
            packed = tomllib.loads(archive.read(MANIFEST).decode("utf-8"))
            generated = packed.get("build", {}).get("generated", {})
            if packed["version"] != manifest["version"]:
                yield f"the version is {packed['version']}, not {manifest['version']}"
            if generated.get("platforms") != [platform]:
                yield f"the manifest is for {generated.get('platforms')}, not {platform}"
            if {f"./{name}" for name in wheels} != set(generated.get("wheels", [])):
                yield "the manifest lists other wheels"
        for name in sorted(wheels & names):
            license_name, parts = license_of(archive.read(name))
            if license_name not in LICENSES:
                yield (
                    f"{name} is under {license_name!r}, which is not known to be compatible with "
                    "the GPL"
                )
                continue
            note = f"; parts under separate terms: {', '.join(parts)}" if parts else ""
            print(f"    {Path(name).name}: {LICENSES[license_name]}{note}")
    try:
        run_tool("validate", str(path))
    except BuildError as error:
        yield str(error)


def check_index(folder: Path, zips: list[Path]) -> Iterator[str]:
    """Yield problems of ``index.json``, from which Blender installs and updates."""
    try:
        entries = json.loads((folder / "index.json").read_text(encoding="utf-8"))["data"]
    except (OSError, ValueError, KeyError) as error:
        yield f"cannot be read ({error})"
        return
    by_name = {entry["archive_url"].removeprefix("./"): entry for entry in entries}
    for name in sorted(by_name.keys() ^ {path.name for path in zips}):
        yield f"{name} is {'not in the folder' if name in by_name else 'missing'}"
    for path in zips:
        if entry := by_name.get(path.name):
            checksum = f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
            if (entry["archive_size"], entry["archive_hash"]) != (path.stat().st_size, checksum):
                yield f"{path.name} has changed since it was indexed"


def main() -> int:
    """Check the folder named on the command line, and print all problems.

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
        help="check only these, such as linux-x64, or 'here' for this machine (default: all)",
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
            problems.append(f"{name}: not found in {options.folder}. Run `make extension`.")
            continue
        zips.append(path)
        print(f"{name}: {path.stat().st_size / 1e6:.1f} MB")
        problems += [f"{name}: {problem}" for problem in check_zip(path, platform, manifest)]
    problems += [f"index.json: {problem}" for problem in check_index(options.folder, zips)]
    others = {path.name for path in options.folder.glob("*.zip")} - {path.name for path in zips}
    if not options.platforms:
        problems += [f"{name}: not part of this release" for name in sorted(others)]
    for problem in problems:
        print(f"release: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
