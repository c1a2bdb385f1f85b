# SPDX-License-Identifier: GPL-3.0-or-later
"""The log holds the messages of all parts, and users can save it."""

import logging
from pathlib import Path
from typing import Any

import bpy
import pytest

from tactile_clay.clay_addon.base import log
from tactile_clay.clay_addon.base.preferences import ADDON, ADDON_VERSION


def test_saved_log_contains_versions_and_messages(studio: Any, tmp_path: Path) -> None:
    """Write the versions of everything, then the messages of any module with tracebacks."""
    try:
        raise ValueError("the reason why")
    except ValueError:
        logging.getLogger(f"{ADDON}.solver.core").exception("a pass failed")
    target = tmp_path / "log.txt"
    assert bpy.ops.clay.log_save(filepath=str(target)) == {"FINISHED"}
    text = target.read_text("utf-8")
    assert ADDON_VERSION in text
    assert bpy.app.version_string in text
    assert "warp-lang" in text
    assert f"ERROR   MainThread {ADDON}.solver.core: a pass failed" in text
    assert "ValueError: the reason why" in text


def test_log_that_cannot_be_saved_says_why(studio: Any, tmp_path: Path) -> None:
    """Report a missing folder instead of failing."""
    with pytest.raises(RuntimeError, match="could not be saved"):
        bpy.ops.clay.log_save(filepath=str(tmp_path / "missing" / "log.txt"))


def test_log_continues_in_a_second_file_and_keeps_the_first(
    studio: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keep at least the newest messages when there are very many."""
    log.log_file.close()
    monkeypatch.setattr(log, "MAX_BYTES", 2000)
    log.log_file.open()
    for number in range(100):
        logging.getLogger(ADDON).info("message %d of many", number)
    text = log.log_file.text()
    assert "message 99 of many" in text
    assert len(text) < 5000


def test_unwritable_folder_costs_only_the_log(
    studio: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Carry on without a log if no file can be created, and say so."""
    log.log_file.close()

    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(logging.handlers, "RotatingFileHandler", refuse)
    log.log_file.open()
    assert "No log is kept: read-only" in caplog.text


def test_nothing_is_written_once_the_addon_is_gone(studio: Any) -> None:
    """Remove the handler from the logger along with the add-on."""
    before = len(logging.getLogger(ADDON).handlers)
    log.log_file.close()
    assert len(logging.getLogger(ADDON).handlers) == before - 1
    log.log_file.close()
    log.log_file.open()
