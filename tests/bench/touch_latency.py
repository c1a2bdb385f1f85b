# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the latency from contact forces on a hand to the last byte sent to an array."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_clay.haptics import ArrayClient, PressureField, TransducerArray, focus

GHOSTS = 2000
FRAME = 1 / 60
FOCI = 8
_PATIENCE = 20.0
_ROUND = 126
"""Number of frames in one round of the moving load."""

FociOf = Callable[[int], Any]
"""Focal points of a frame, from the contact forces of that frame."""


@dataclass(frozen=True)
class Contacts:
    """Contacts of a hand as a solver reports them."""

    positions: NDArray[np.float64]
    """Positions of the ghosts [m], shape [G, 3]."""
    normals: NDArray[np.float64]
    """Outward normals, shape [G, 3]."""
    areas: NDArray[np.float64]
    """Area of skin that each represents [m²], shape [G]."""
    forces: NDArray[np.float64]
    """Force on each [N], shape [G, 3]."""


def palm_contacts(frame: int) -> Contacts:
    """A rounded palm above the array, with three moving pressure peaks."""
    random = np.random.default_rng(1)
    place = random.uniform(-0.045, 0.045, (GHOSTS, 2))
    height = 0.18 + 8.0 * (place**2).sum(1)
    positions = np.column_stack((place, height))
    normals = np.column_stack((16.0 * place, -np.ones(GHOSTS)))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    areas = np.full(GHOSTS, 0.09**2 / GHOSTS)
    pressure = np.zeros(GHOSTS)
    for turn in range(3):
        angle = 2.0 * np.pi * (frame / _ROUND + turn / 3.0)
        middle = 0.025 * np.array((np.cos(angle), np.sin(angle)))
        pressure += 3e4 * np.exp(-0.5 * ((place - middle) ** 2).sum(1) / 0.008**2)
    return Contacts(positions, normals, areas, -normals * (pressure * areas)[:, None])


def foci_of_contacts() -> FociOf:
    """The whole pipeline of a live scene: pressure field, then focal points, warm-started."""
    array = TransducerArray.preset("sonicsurface")
    # A solver would provide them, so making them is not timed.
    given = [palm_contacts(frame) for frame in range(_ROUND)]
    last: dict[str, Any] = {"field": None, "foci": None}

    def next_foci(frame: int) -> Any:
        field = PressureField.from_contacts(
            given[frame % _ROUND], array.position, previous=last["field"], dt=FRAME
        )
        last["field"] = field
        last["foci"] = focus(
            field.positions,
            field.pressures,
            field.weights,
            count=FOCI,
            sigma=array.wavelength,
            previous=last["foci"],
        )
        return last["foci"]

    return next_foci


@contextlib.contextmanager
def drained_port() -> Iterator[str]:
    """A port that accepts whatever is written to it; needs ptys."""
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    ending = threading.Event()

    def drain() -> None:
        while not ending.is_set():
            with contextlib.suppress(OSError):
                os.read(master, 65536)

    thread = threading.Thread(target=drain, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ending.set()
        os.write(slave, b"end")
        thread.join()
        os.close(slave)
        os.close(master)


def measure_device(device: str, next_foci: FociOf, *, frames: int = 300) -> dict[str, Any]:
    """Play frames at 60 Hz to an array server.

    Args:
        device: The device's name.
        next_foci: Returns the focal points to send in a frame.
        frames: Number of frames.

    Returns:
        Figures that include the median and 99th percentile of the time from contact forces to the
        last byte [ms], as the server counts it: until the data are handed over, plus the wire's
        time for everything queued before. The first frames, until the array sounds, are included.

    Raises:
        TimeoutError: The array does not sound.
    """
    spent = []
    with ArrayClient.start(device) as out:
        end = time.monotonic() + _PATIENCE
        while not out.status().frames_per_second:
            if time.monotonic() > end:
                raise TimeoutError(f"{device} does not sound: {out.status()}")
            out.send(next_foci(0))
            time.sleep(FRAME)
        due = time.monotonic()
        for frame in range(frames):
            begin = time.monotonic()
            foci = next_foci(frame)
            out.send(foci, time=begin)
            spent.append(time.monotonic() - begin)
            due = max(due + FRAME, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
        status = out.status(wait=0.5)
    return {
        "device": device.split(",")[0].partition("/")[0] if "/" in device else device,
        "focus_ms": 1e3 * float(np.median(spent[frames // 5 :])),
        "latency_ms": None if status.latency is None else 1e3 * status.latency,
        "latency_p99_ms": None if status.latency_p99 is None else 1e3 * status.latency_p99,
        "frames_per_second": status.frames_per_second,
        "dropped": status.dropped,
    }


def measure_all(*, frames: int = 300) -> list[dict[str, Any]]:
    """Measure all devices that need no hardware."""
    results = [
        {"case": f"touch, simulated {preset}"}
        | measure_device(f"simulated:{preset}", foci_of_contacts(), frames=frames)
        for preset in ("openmpd", "autd3")
    ]
    if sys.platform != "win32":
        for firmware in ("stock", "tactile"):
            with drained_port() as port:
                name = f"sonicsurface:{port},firmware={firmware}"
                figures = measure_device(name, foci_of_contacts(), frames=frames)
                results.append({"case": f"touch, sonicsurface {firmware}"} | figures)
    return results


def sentence(figures: dict[str, Any]) -> str:
    """One line about a case."""
    return (
        f"{figures['case']:>28}  {figures['latency_ms']:5.1f} ms from contact forces to the last "
        f"byte (p99 {figures['latency_p99_ms']:.1f}), of which pressure field and foci "
        f"{figures['focus_ms']:.2f} ms; {figures['frames_per_second']} frames/s"
    )
