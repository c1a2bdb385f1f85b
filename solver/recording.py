# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording passes once and replaying them: launching from Python costs more than a small pass."""

from collections.abc import Callable, Hashable

import warp as wp

MOST_RECORDINGS = 64
"""Recordings kept; the oldest goes first."""


class Recordings:
    """Runs sequences of kernel launches, recording each the first time it is seen.

    Everything that a sequence launches with is recorded as it is: arrays by address, numbers by
    value. The key must tell apart whatever can differ.

    Args:
        device: Warp device.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._graphs: dict[Hashable, wp.Graph] = {}
        self._seen: set[Hashable] = set()

    def run(self, key: Hashable, launch: Callable[[], None]) -> None:
        """Do what ``launch`` launches, by replay where the key is known."""
        graph = self._graphs.get(key)
        if graph is not None:
            wp.capture_launch(graph)
            return
        # The first time runs plainly: it loads modules, and steps of a length seen only once
        # are not worth recording.
        if key not in self._seen:
            self._seen.add(key)
            launch()
            return
        with wp.ScopedCapture(device=self.device) as capture:
            launch()
        if len(self._graphs) >= MOST_RECORDINGS:
            del self._graphs[next(iter(self._graphs))]
        self._graphs[key] = capture.graph
        wp.capture_launch(capture.graph)

    def clear(self) -> None:
        """Forget all recordings, when arrays that they use go away."""
        self._graphs.clear()
        self._seen.clear()
