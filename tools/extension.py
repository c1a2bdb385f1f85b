# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zips, one a platform, with Blender's own tool, validate and index them.

The manifest says everything: which platforms, which wheels, which files. The wheels are fetched
into ``wheels`` with pip once; the sources are laid out in a folder of their own and packed from
there, so that a zip for one platform asks only for that platform's wheels. The folder of the zips
is a repository that Blender installs and updates from, once a web server shows it.
"""

import argparse
import importlib.util
import json
import platform as host
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
MANIFEST = "blender_manifest.toml"
WHEELS = ROOT / "wheels"
# Blender 4.5 has the oldest Python that a wheel must serve.
OLDEST_PYTHON = "3.11"
WHEEL_TAGS = {
    "linux-x64": r"manylinux.*_x86_64",
    "windows-x64": r"win_amd64",
    "macos-arm64": r"macosx_.*_(arm64|universal2)",
}


class BuildError(Exception):
    """What went wrong and what to do, for a person to read."""


def platform_here() -> str:
    """Name the platform this runs on in the manifest's words."""
    system = {"Darwin": "macos"}.get(host.system(), host.system().lower())
    machine = host.machine().lower()
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(machine, machine)
    return f"{system}-{machine}"


def wheels_for(manifest: dict[str, Any], platform: str) -> list[str]:
    """List the file names of the wheels that one platform needs."""
    tag = re.compile(rf"-(any|{WHEEL_TAGS[platform]})\.whl$")
    names = [Path(wheel).name for wheel in manifest["wheels"]]
    return [name for name in names if tag.search(name)]


def fetch_wheel(name: str) -> None:
    """Download one wheel into `WHEELS`, unless it is there.

    Args:
        name: The wheel's file name, from which its project, version and platform are read.

    Raises:
        BuildError: pip failed, or the package index has another build of that version.
    """
    target = WHEELS / name
    if zipfile.is_zipfile(target):
        return
    project, version, _, _, platform = name.removesuffix(".whl").split("-")
    print(f"  fetching {name}", flush=True)
    WHEELS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".partial-", dir=WHEELS) as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input"]
        command += ["--disable-pip-version-check", "--only-binary=:all:", "--no-deps"]
        command += ["--python-version", OLDEST_PYTHON, "--dest", folder]
        for tag in platform.split("."):
            command += ["--platform", tag]
        command.append(f"{project.replace('_', '-')}=={version}")
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise BuildError(f"pip could not fetch {name}:\n{result.stderr.strip()}")
        found = [path.name for path in Path(folder).iterdir()]
        if found != [name]:
            raise BuildError(
                f"The manifest asks for {name}, but the package index gives {', '.join(found)}. "
                f"Correct the list of wheels in {MANIFEST}."
            )
        (Path(folder) / name).replace(target)


def restrict_manifest(text: str, platforms: list[str], wheels: list[str]) -> str:
    """Return the manifest's text with other lists of platforms and wheels.

    Raises:
        BuildError: The manifest has no such lists, or not in the usual form.
    """
    lists = {"platforms": platforms, "wheels": [f"./wheels/{name}" for name in wheels]}
    for key, values in lists.items():
        # No wheels at all is said by leaving the key out.
        line = f"{key} = {json.dumps(values)}" if values else ""
        text, count = re.subn(rf"^{key} = \[[^\]]*\]$", line, text, count=1, flags=re.MULTILINE)
        if count != 1:
            raise BuildError(f"{MANIFEST} has no list named {key}.")
    return text


def lay_out(manifest: dict[str, Any], text: str, folder: Path) -> None:
    """Copy what the manifest lets in to an empty folder.

    Args:
        manifest: The parsed manifest, whose patterns that begin with ``!/`` name what goes in.
        text: The manifest to lay beside it.
        folder: The empty folder.

    Raises:
        BuildError: A file or folder that the manifest names is missing.
    """
    for pattern in manifest["build"]["paths_exclude_pattern"]:
        if not pattern.startswith("!/"):
            continue
        name = pattern.removeprefix("!/").rstrip("/")
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.is_file():
            shutil.copy2(source, folder / name)
        else:
            raise BuildError(f"{MANIFEST} lets {name} in, but there is no such file or folder.")
    (folder / MANIFEST).write_text(text, encoding="utf-8")
    (folder / "wheels").symlink_to(WHEELS)


def blender_tool() -> Path:
    """Find Blender's extension tool inside the bpy module.

    Raises:
        BuildError: The module is not installed or has no such tool.
    """
    spec = importlib.util.find_spec("bpy")
    if spec is not None and spec.origin is not None:
        for path in Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/*.py"):
            if path.name == "blender_ext.py":
                return path
    raise BuildError("Blender's module (bpy) is not in this Python: use `make extension`.")


def run_tool(*arguments: str) -> None:
    """Run Blender's extension tool.

    Raises:
        BuildError: It failed; the message is what it said.
    """
    command = [sys.executable, str(blender_tool()), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        said = (result.stdout + result.stderr).strip()
        raise BuildError(f"blender_ext.py {' '.join(arguments)}:\n{said}")


def build(platforms: list[str], output: Path, *, with_wheels: bool = True) -> list[Path]:
    """Build and validate the zips.

    Args:
        platforms: Platforms in the manifest's words; empty for all that the manifest names.
        output: Folder for the zips; zips of the same name are replaced.
        with_wheels: Whether to bundle the wheels. Without them the zip is for looking into.

    Returns:
        The zips, one a platform.

    Raises:
        BuildError: Something is missing or does not validate.
    """
    text = (ROOT / MANIFEST).read_text(encoding="utf-8")
    manifest = tomllib.loads(text)
    platforms = platforms or manifest["platforms"]
    unknown = [name for name in platforms if name not in manifest["platforms"]]
    if unknown:
        raise BuildError(
            f"There is no extension for {', '.join(unknown)}; "
            f"there is one for {', '.join(manifest['platforms'])}."
        )
    wheels: list[str] = []
    if with_wheels:
        wheels = sorted({name for platform in platforms for name in wheels_for(manifest, platform)})
        for name in wheels:
            fetch_wheel(name)
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="tactile-clay-") as source:
        lay_out(manifest, restrict_manifest(text, platforms, wheels), Path(source))
        run_tool("validate", source)
        run_tool("build", "--split-platforms", "--source-dir", source, "--output-dir", str(output))
    stem = f"{manifest['id']}-{manifest['version']}"
    zips = [output / f"{stem}-{platform.replace('-', '_')}.zip" for platform in platforms]
    for path in zips:
        run_tool("validate", str(path))
    return zips


def write_index(output: Path) -> Path:
    """Write ``index.json``, and ``index.html`` for people, of this version's zips in a folder.

    Zips of other versions may lie there: a repository has one version at a time.

    Returns:
        The path of ``index.json``.

    Raises:
        BuildError: Blender's tool failed.
    """
    manifest = tomllib.loads((ROOT / MANIFEST).read_text(encoding="utf-8"))
    zips = sorted(output.glob(f"{manifest['id']}-{manifest['version']}-*.zip"))
    with tempfile.TemporaryDirectory(prefix=".index-", dir=output) as folder:
        for path in zips:
            (Path(folder) / path.name).symlink_to(path.resolve())
        run_tool("server-generate", "--html", "--repo-dir", folder)
        index = Path(folder) / "index.json"
        # Blender's tool lists in the order of the file system, which differs from day to day.
        table = json.loads(index.read_text(encoding="utf-8"))
        table["data"].sort(key=lambda entry: entry["archive_url"])
        if [entry["archive_url"] for entry in table["data"]] != [f"./{path.name}" for path in zips]:
            raise BuildError(f"Blender's tool did not put every zip of {output} into its index.")
        index.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
        for name in ("index.html", "index.json"):
            (Path(folder) / name).replace(output / name)
    return output / "index.json"


def main() -> int:
    """Build what the command line asks for and say what came of it.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description="Build the extension's zips, one a platform.")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zips")
    parser.add_argument(
        "--platforms",
        nargs="+",
        default=[],
        metavar="PLATFORM",
        help="only these, such as linux-x64; 'here' is this machine's",
    )
    parser.add_argument("--without-wheels", action="store_true", help="leave the wheels out")
    options = parser.parse_args()
    platforms = [platform_here() if name == "here" else name for name in options.platforms]
    try:
        output = options.output.resolve()
        zips = build(platforms, output, with_wheels=not options.without_wheels)
        index = write_index(output)
    except BuildError as error:
        print(f"extension: {error}", file=sys.stderr)
        return 1
    for path in zips:
        print(f"{path}  {path.stat().st_size / 1e6:.1f} MB")
    print(index)
    return 0


if __name__ == "__main__":
    sys.exit(main())
