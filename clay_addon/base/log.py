# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's log file, which users can attach to a bug report.

Every module of the package logs under its own name, below the logger of the package. While the
add-on is registered, messages go to a file in Blender's temporary folder, which survives a crash.
*Preferences > Save Log* copies them together with a description of the system. Warnings are also
printed to the console.
"""

import importlib.metadata
import logging
import logging.handlers
import os
import platform
import sys
from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from ..core.storage.atomic_files import replace_text
from .preferences import ADDON, ADDON_VERSION, device_choice

MAX_BYTES = 1_000_000
"""Size at which the log file is rotated; one old file is kept."""
PACKAGES = ("numpy", "warp-lang", "trimesh", "pysplashsurf", "pyserial", "pyusb", "websockets")
"""Packages whose versions a saved log lists."""
_FORMAT = "%(asctime)s %(levelname)-7s %(threadName)s %(name)s: %(message)s"

_logger = logging.getLogger(ADDON)


class LogFile:
    """Receives the package's log messages between `open` and `close`."""

    def __init__(self) -> None:
        self._handler: logging.Handler | None = None
        self.path = Path()
        """The log file; meaningful while it is open."""

    def open(self) -> None:
        """Start logging; a second call does nothing.

        If the folder is not writable there is no log, but the add-on still works.
        """
        if self._handler is not None:
            return
        self.path = Path(bpy.app.tempdir) / f"tactile_clay_{os.getpid()}.log"
        try:
            handler: logging.Handler = logging.handlers.RotatingFileHandler(
                self.path, maxBytes=MAX_BYTES, backupCount=1, encoding="utf-8"
            )
        except OSError as error:
            _logger.warning("No log is kept: %s", error)
            handler = logging.NullHandler()
        handler.setFormatter(logging.Formatter(_FORMAT))
        _logger.addHandler(handler)
        _logger.setLevel(logging.INFO)
        self._handler = handler

    def close(self) -> None:
        """Stop logging; the file stays until Blender empties its temporary folder."""
        if self._handler is not None:
            _logger.removeHandler(self._handler)
            self._handler.close()
            self._handler = None

    def text(self) -> str:
        """The messages since Blender started, oldest first, except those rotated away."""
        if self._handler is not None:
            self._handler.flush()
        parts = []
        for path in (self.path.with_name(self.path.name + ".1"), self.path):
            if path.is_file():
                parts.append(path.read_text(encoding="utf-8", errors="replace"))
        return "".join(parts)


log_file = LogFile()
"""The log of this Blender process."""


def system_information() -> str:
    """What a bug report needs to say about the installation, one fact per line."""
    lines = [
        f"Tactile Clay {ADDON_VERSION} as {ADDON}",
        f"Blender {bpy.app.version_string} ({bpy.app.build_platform.decode()})"
        f"{', in the background' if bpy.app.background else ''}",
        f"Python {sys.version.split()[0]} on {platform.platform()}, {os.cpu_count()} processors",
        f"Device: {device_choice(bpy.context)}",
    ]
    for package in PACKAGES:
        try:
            lines.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            lines.append(f"{package} is missing")
    return "\n".join(lines)


class CLAY_OT_log_save(bpy.types.Operator, ExportHelper):  # noqa: N801
    """Save the add-on's messages since Blender started, to attach to a bug report"""

    bl_idname = "clay.log_save"
    bl_label = "Save Log"

    filename_ext = ".txt"
    filter_glob: bpy.props.StringProperty(default="*.txt", options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the file."""
        path = Path(bpy.path.abspath(self.filepath))
        try:
            replace_text(path, f"{system_information()}\n\n{log_file.text()}")
        except OSError as error:
            self.report({"ERROR"}, f"The log could not be saved: {error}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Saved {path}")
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        self.filepath = "tactile_clay_log.txt"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


def register() -> None:
    """Register the operator and start the log."""
    bpy.utils.register_class(CLAY_OT_log_save)
    log_file.open()
    _logger.info("Registered: version %s, Blender %s", ADDON_VERSION, bpy.app.version_string)


def unregister() -> None:
    """Stop the log and unregister the operator."""
    log_file.close()
    bpy.utils.unregister_class(CLAY_OT_log_save)
