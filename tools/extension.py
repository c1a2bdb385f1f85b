# SPDX-License-Identifier: GPL-3.0-or-later
"""Build, validate and index the extension's zips, one per platform, with Blender's own tool.

The manifest lists the platforms, wheels and files. The wheels are downloaded to ``wheels`` with pip
once. The sources are packed from a temporary folder, so that a zip for one platform needs only that
platform's wheels. Served by a web server, the folder of the zips is a repository from which Blender
installs and updates.
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
# The oldest Python that wheels must support is that of Blender 4.5.
MIN_PYTHON = "3.11"
WHEEL_TAGS = {
    "linux-x64": r"manylinux.*_x86_64",
    "windows-x64": r"win_amd64",
    "macos-arm64": r"macosx_.*_(arm64|universal2)",
}


class BuildError(Exception):
    """A build step failed; the message says why and what to do."""


def platform_here() -> str:
    """Name of this machine's platform, as in the manifest."""
    system = {"Darwin": "macos"}.get(host.system(), host.system().lower())
    machine = host.machine().lower()
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(machine, machine)
    return f"{system}-{machine}"


def wheels_for(manifest: dict[str, Any], platform: str) -> list[str]:
    """File names of the wheels for one platform."""
    tag = re.compile(rf"-(any|{WHEEL_TAGS[platform]})\.whl$")
    names = [Path(wheel).name for wheel in manifest["wheels"]]
    return [name for name in names if tag.search(name)]


def fetch_wheel(name: str) -> None:
    """Download a wheel to `WHEELS`, unless it exists.

    Args:
        name: File name of the wheel, which includes project, version and platform.

    Raises:
        BuildError: pip failed, or the package index has another build of that version.
    """
    target = WHEELS / name
    if zipfile.is_zipfile(target):
        return
    project, version, _, _, platform = name.removesuffix(".whl").split("-")
    print(f"  downloading {name}", flush=True)
    WHEELS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".partial-", dir=WHEELS) as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input"]
        command += ["--disable-pip-version-check", "--only-binary=:all:", "--no-deps"]
        command += ["--python-version", MIN_PYTHON, "--dest", folder]
        for tag in platform.split("."):
            command += ["--platform", tag]
        command.append(f"{project.replace('_', '-')}=={version}")
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise BuildError(f"pip could not download {name}:\n{result.stderr.strip()}")
        found = [path.name for path in Path(folder).iterdir()]
        if found != [name]:
            raise BuildError(
                f"The manifest lists {name}, but the package index has {', '.join(found)}. "
                f"Correct the list of wheels in {MANIFEST}."
            )
        (Path(folder) / name).replace(target)


def restrict_manifest(text: str, platforms: list[str], wheels: list[str]) -> str:
    """Replace the lists of platforms and wheels in the manifest's text.

    Raises:
        BuildError: The manifest has no such lists, or in an unexpected form.
    """
    lists = {"platforms": platforms, "wheels": [f"./wheels/{name}" for name in wheels]}
    for key, values in lists.items():
        # The key must be omitted if there are no wheels.
        line = f"{key} = {json.dumps(values)}" if values else ""
        text, count = re.subn(rf"^{key} = \[[^\]]*\]$", line, text, count=1, flags=re.MULTILINE)
        if count != 1:
            raise BuildError(f"{MANIFEST} has no list named {key}.")
    return text


def copy_sources(manifest: dict[str, Any], text: str, folder: Path) -> None:
    """Copy the files that belong in a zip to an empty folder.

    Args:
        manifest: The parsed manifest, whose patterns that begin with ``!/`` list these files.
        text: Text of the manifest for the zip.
        folder: The empty folder.

    Raises:
        BuildError: A file or folder listed in the manifest is missing.
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
            raise BuildError(f"{MANIFEST} includes {name}, but there is no such file or folder.")
    (folder / MANIFEST).write_text(text, encoding="utf-8")
    (folder / "wheels").symlink_to(WHEELS)


def blender_tool() -> Path:
    """Find Blender's extension tool inside the bpy module.

    Raises:
        BuildError: The module is not installed, or does not contain the tool.
    """
    spec = importlib.util.find_spec("bpy")
    if spec is not None and spec.origin is not None:
        for path in Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/*.py"):
            if path.name == "blender_ext.py":
                return path
    raise BuildError("The bpy module is not installed in this Python: use `make extension`.")


def run_tool(*arguments: str) -> None:
    """Run Blender's extension tool.

    Raises:
        BuildError: The tool failed; the message contains its output.
    """
    command = [sys.executable, str(blender_tool()), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        output = (result.stdout + result.stderr).strip()
        raise BuildError(f"blender_ext.py {' '.join(arguments)}:\n{output}")


def build(platforms: list[str], output: Path, *, with_wheels: bool = True) -> list[Path]:
    """Build and validate the zips.

    Args:
        platforms: Platforms as named in the manifest; empty for all.
        output: Folder for the zips; zips of the same name are replaced.
        with_wheels: Whether to bundle the wheels. Without them, a zip is only for inspection.

    Returns:
        The zips, one per platform.

    Raises:
        BuildError: A file is missing, or a zip is not valid.
    """
    text = (ROOT / MANIFEST).read_text(encoding="utf-8")
    manifest = tomllib.loads(text)
    platforms = platforms or manifest["platforms"]
    unknown = [name for name in platforms if name not in manifest["platforms"]]
    if unknown:
        raise BuildError(
            f"There is no extension for {', '.join(unknown)}. "
            f"The platforms are: {', '.join(manifest['platforms'])}."
        )
    wheels: list[str] = []
    if with_wheels:
        wheels = sorted({name for platform in platforms for name in wheels_for(manifest, platform)})
        for name in wheels:
            fetch_wheel(name)
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="tactile-clay-") as source:
        copy_sources(manifest, restrict_manifest(text, platforms, wheels), Path(source))
        run_tool("validate", source)
        run_tool("build", "--split-platforms", "--source-dir", source, "--output-dir", str(output))
    stem = f"{manifest['id']}-{manifest['version']}"
    zips = [output / f"{stem}-{platform.replace('-', '_')}.zip" for platform in platforms]
    for path in zips:
        run_tool("validate", str(path))
    return zips


def write_index(output: Path) -> Path:
    """Write ``index.json`` and ``index.html`` for this version's zips in a folder.

    Zips of other versions are ignored, since a repository has one version at a time.

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
        # Blender's tool uses the order of the file system, which is arbitrary.
        table = json.loads(index.read_text(encoding="utf-8"))
        table["data"].sort(key=lambda entry: entry["archive_url"])
        if [entry["archive_url"] for entry in table["data"]] != [f"./{path.name}" for path in zips]:
            raise BuildError(f"Blender's tool did not include every zip of {output} in its index.")
        index.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
        for name in ("index.html", "index.json"):
            (Path(folder) / name).replace(output / name)
    return output / "index.json"


def main() -> int:
    """Build the zips requested on the command line.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description="Build the extension's zips, one per platform.")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zips")
    parser.add_argument(
        "--platforms",
        nargs="+",
        default=[],
        metavar="PLATFORM",
        help="build only these, such as linux-x64, or 'here' for this machine (default: all)",
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
