# SPDX-License-Identifier: GPL-3.0-or-later
"""Human-readable durations and sizes."""


def duration_text(seconds: float | None) -> str:
    """A duration, such as ``2 min 05 s``; an ellipsis if it is unknown."""
    if seconds is None:
        return "…"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def size_text(count: int) -> str:
    """A number of bytes, such as ``1.2 MB``."""
    size = float(count)
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.3g} {unit}" if unit != "bytes" else f"{count} bytes"
        size /= 1000
    raise AssertionError
