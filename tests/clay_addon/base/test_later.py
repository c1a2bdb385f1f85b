# SPDX-License-Identifier: GPL-3.0-or-later
"""Handlers defer what Blender does not allow inside them."""

import ast
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tactile_clay.clay_addon.base import later as module
from tactile_clay.clay_addon.base.later import Later

DEFERRED = ("undo_post", "redo_post", "undo_pre", "redo_pre", "load_post", "depsgraph_update_post")
"""Handlers that must not create, remove, hide or show anything."""


@pytest.fixture
def timers(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Functions registered as timers, in a Blender with an interface."""
    waiting: list[Any] = []
    fake = SimpleNamespace(
        is_registered=lambda function: function in waiting,
        register=lambda function, **_: waiting.append(function),
        unregister=waiting.remove,
    )
    monkeypatch.setattr(
        module, "bpy", SimpleNamespace(app=SimpleNamespace(background=False, timers=fake))
    )
    return waiting


def test_work_waits_for_the_timer_and_is_done_once(timers: list[Any]) -> None:
    """Do nothing immediately, then each thing once, in the order first scheduled."""
    queue = Later()
    done: list[str] = []
    first, second = (lambda: done.append("first")), (lambda: done.append("second"))
    for work in (first, second, first):
        queue.schedule(work)
    assert done == []
    assert len(timers) == 1
    queue.run()
    queue.run()
    assert done == ["first", "second"]


def test_failure_is_logged_and_does_not_stop_the_rest(
    timers: list[Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Continue with the rest, and leave a traceback in the log."""
    queue = Later()
    done: list[str] = []
    queue.schedule(lambda: 1 / 0)
    queue.schedule(lambda: done.append("rest"))
    queue.run()
    assert done == ["rest"]
    assert "ZeroDivisionError" in caplog.text


def test_work_may_schedule_more_work(timers: list[Any]) -> None:
    """Do work scheduled by other work in the same run."""
    queue = Later()
    done: list[str] = []
    more = lambda: done.append("more")  # noqa: E731
    queue.schedule(lambda: queue.schedule(more))
    queue.run()
    assert done == ["more"]


def test_without_an_interface_work_is_done_at_once() -> None:
    """Use no timer in the background."""
    done: list[str] = []
    Later().schedule(lambda: done.append("now"))
    assert done == ["now"]


def test_undo_and_load_handlers_change_no_data(repository: Path) -> None:
    """Change no Blender data in handlers for undo, redo, load and depsgraph updates.

    A handler may read, clear its own state and schedule work.
    """
    forbidden = {
        "remove",
        "new",
        "link",
        "unlink",
        "hide_set",
        "select_set",
        "update",
        "foreach_set",
    }
    wrong = []
    for path in sorted((repository / "clay_addon").rglob("*.py")):
        tree = ast.parse(path.read_text("utf-8"))
        functions = {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef)}
        pairs = [
            (pair.elts[0].value, pair.elts[1].id)
            for pair in ast.walk(tree)
            if isinstance(pair, ast.Tuple)
            and len(pair.elts) == 2
            and isinstance(pair.elts[0], ast.Constant)
            and isinstance(pair.elts[1], ast.Name)
        ]
        for event, name in pairs:
            if event not in DEFERRED or name not in functions:
                continue
            calls = [
                node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
                for node in ast.walk(functions[name])
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name)
            ]
            if forbidden & set(calls) or "setattr" in calls:
                wrong.append(f"{path.name}: {name} at {event}")
    assert wrong == []
