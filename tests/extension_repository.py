# SPDX-License-Identifier: GPL-3.0-or-later
"""A repository of extensions on this machine, as the one that people's Blender updates from."""

import importlib.util
import subprocess
import sys
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

OLD_VERSION = "0.0.9"
OLD_FILE = "clay_addon/not_in_the_new_version.py"


class _QuietHandler(SimpleHTTPRequestHandler):
    """Serves files and says nothing."""

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Serve a folder on loopback while the context lasts, and give the URL of its index."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_QuietHandler, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/index.json"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def make_older(zip_path: Path, version: str, folder: Path) -> Path:
    """Write a zip of an older version, which has a file that newer ones have not.

    Args:
        zip_path: A zip of the version now.
        version: The version now.
        folder: Where the older zip goes.
    """
    older = folder / zip_path.name.replace(version, OLD_VERSION)
    with zipfile.ZipFile(zip_path) as source, zipfile.ZipFile(older, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "blender_manifest.toml":
                line = f'version = "{version}"'.encode()
                assert content.count(line) == 1
                content = content.replace(line, f'version = "{OLD_VERSION}"'.encode())
            target.writestr(name, content)
        target.writestr(OLD_FILE, "")
    run_tool("server-generate", "--repo-dir", str(folder))
    return older


def run_tool(*arguments: str) -> str:
    """Run Blender's extension tool from the bpy module, and return what it said."""
    spec = importlib.util.find_spec("bpy")
    assert spec is not None
    assert spec.origin is not None
    (tool,) = Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    result = subprocess.run(
        [sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout
