# SPDX-License-Identifier: GPL-3.0-or-later
"""Edits of a take, carried out on the film's clay: by the same means as live, at its spacing."""

from __future__ import annotations

from typing import get_args

from .take_files import Edit


def unknown_edit(edits: list[Edit]) -> Edit | None:
    """The first edit of a kind that this add-on does not know; None where it knows all."""
    known = edit_kinds()
    return next((edit for edit in edits if edit.kind not in known), None)


def edit_kinds() -> tuple[str, ...]:
    """The kinds of edits there are."""
    try:
        from .edits import EditKind
    except ImportError:
        return ()
    return get_args(EditKind)
