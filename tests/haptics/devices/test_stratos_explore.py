# SPDX-License-Identifier: GPL-3.0-or-later
"""The bridge to Ultraleap's SDK, compiled with stubs of its headers and run."""

import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.haptics import ArrayClient
from tactile_clay.haptics.devices import DeviceError, make_device
from tactile_clay.haptics.protocol.datagram import Kind, encode
from tactile_clay.tests.haptics.peers.harness import PATIENCE, PlainFoci, foci, keep_sending

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
SOURCES = Path(__file__).resolve().parents[3] / "haptics" / "devices" / "stratos_explore"
STUBS = Path(__file__).resolve().parent / "stratos_stubs"
FOUR = foci(
    (0.0, 0.0, 0.2, 900.0),
    (0.01, 0.0, 0.2, 100.0),
    (0.02, 0.0, 0.2, 1500.0),
    (0.0, -0.03, 0.15, 300.0),
)

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C++ compiler")


def compile_program(target: Path, *sources: Path) -> Path:
    """Compile with all warnings as errors."""
    assert COMPILER
    command = [COMPILER, "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-pthread"]
    command += ["-I", str(STUBS), "-I", str(SOURCES), *map(str, sources), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


@pytest.fixture(scope="module", params=[2, 3])
def bridge(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bridge for one SDK, in a script that records the calls of the SDK."""
    version: int = request.param
    folder = tmp_path_factory.mktemp(f"sdk{version}")
    program = compile_program(
        folder / "bridge", SOURCES / "bridge.cpp", SOURCES / f"sdk{version}.cpp"
    )
    script = folder / "stratos_bridge"
    script.write_text(
        f"#!/bin/sh\nexec '{program}' \"$1\" 2>>'{folder}/said.txt'\n", encoding="utf-8"
    )
    script.chmod(0o755)
    return script


def said(bridge: Path) -> list[str]:
    """The calls of the SDK so far."""
    path = bridge.parent / "said.txt"
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


def is_silence(line: str) -> bool:
    """Whether a call means silence; a callback may end just after a pause."""
    words = line.split()
    quiet = words[0] == "sample" and all(point.endswith(",0.0000") for point in words[1:])
    return quiet or line in ("stop", "pause")


def wait_for_silence(bridge: Path) -> None:
    """Wait until the last call means silence and no more calls follow."""
    end = time.monotonic() + PATIENCE
    quiet = 0
    while quiet < 5:
        assert time.monotonic() < end, said(bridge)[-3:]
        before = said(bridge)
        time.sleep(0.02)
        after = said(bridge)
        quiet = quiet + 1 if before == after and is_silence(after[-1]) else 0


@needs_compiler
def test_points_reach_the_sdk_and_stop_with_the_data(bridge: Path) -> None:
    """Pass on positions and intensities at 200 Hz, and stop when focal points end."""
    (bridge.parent / "said.txt").unlink(missing_ok=True)
    with ArrayClient.start(f"stratos_explore:{bridge}") as out:
        keep_sending(out, FOUR, lambda: len(said(bridge)) > 60, "emission", pace=0.005)
        keep_sending(out, FOUR, lambda: out.status().connected, "a connection")
        wait_for_silence(bridge)
        table = [
            [tuple(map(float, point.split(","))) for point in line.split()[1:]]
            for line in said(bridge)
            if line.startswith(("update", "sample")) and not is_silence(line)
        ]
        keep_sending(out, FOUR, lambda: not is_silence(said(bridge)[-1]), "emission")
    assert is_silence(said(bridge)[-1])
    strongest = np.array(table[-1])
    rows = np.array([row[:4] for row in strongest])
    wanted = np.c_[FOUR.positions, FOUR.pressures][[2, 0, 3, 1]]
    assert rows[:4, :3] == pytest.approx(wanted[:, :3], abs=1e-4)
    highest = np.max([[row[3] for row in line] for line in table], axis=0)
    assert highest[:4] == pytest.approx([1.0, 0.9, 0.3, 0.1], abs=0.01)
    assert (highest[4:] == 0.0).all()
    if strongest.shape[1] == 5:
        assert (strongest[:, 4] == 200.0).all()
    else:
        lowest = np.min([[row[3] for row in line] for line in table], axis=0)
        assert lowest[:4].max() < 0.05


@needs_compiler
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_the_array_stops_with_the_server(bridge: Path, end: signal.Signals) -> None:
    """Stop the array when the server is killed: the bridge is a watchdog."""
    (bridge.parent / "said.txt").unlink(missing_ok=True)
    with ArrayClient.start(f"stratos_explore:{bridge}") as out:
        keep_sending(out, FOUR, lambda: len(said(bridge)) > 20, "emission")
        assert out.process
        out.process.send_signal(end)
        wait_for_silence(bridge)


READER = """
#include <cstdio>
#include "focal_points.hpp"
int main() {
    static unsigned char data[65536];
    unsigned size;
    while (std::scanf("%u", &size) == 1) {
        for (unsigned i = 0; i < size; ++i) {
            unsigned byte;
            if (std::scanf("%u", &byte) != 1) return 1;
            data[i] = static_cast<unsigned char>(byte);
        }
        const auto read = tactile_clay::read_focal_points(data, size, 8);
        if (!read) {
            std::puts("refused");
            continue;
        }
        std::printf("%zu %d", read->points.size(), read->modulated);
        for (const auto &one : read->points)
            std::printf(" %.9g %.9g %.9g %.9g", one.x, one.y, one.z, one.intensity);
        std::puts("");
    }
}
"""


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A program that decodes datagrams like the bridge."""
    if COMPILER is None:
        pytest.skip("there is no C++ compiler")
    folder = tmp_path_factory.mktemp("reader")
    (folder / "reader.cpp").write_text(READER, encoding="utf-8")
    return compile_program(folder / "reader", folder / "reader.cpp")


def read_by(reader: Path, datagrams: list[bytes]) -> list[str]:
    """The program's output for datagrams."""
    text = "\n".join(f"{len(data)} {' '.join(map(str, data))}" for data in datagrams)
    return subprocess.run(
        [reader], input=text, capture_output=True, text=True, check=True
    ).stdout.splitlines()


def datagram(points: PlainFoci) -> bytes:
    """A datagram with these points."""
    return encode(
        Kind.FOCI,
        session=3,
        sequence=4,
        time=5.0,
        positions=points.positions,
        pressures=points.pressures,
    )


@given(st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 7)), min_size=1, max_size=20))
@settings(max_examples=10, deadline=None)
def test_the_bridge_refuses_what_is_not_whole(reader: Path, flips: list[tuple[int, int]]) -> None:
    """Refuse any datagram with a flipped bit, and accept a valid one."""
    whole = datagram(foci((0.01, 0.02, 0.2, 0.5)))
    broken = []
    for place, bit in flips:
        changed = bytearray(whole)
        changed[place % len(whole)] ^= 1 << bit
        broken.append(bytes(changed))
    lines = read_by(reader, [whole, *broken, whole[:-1], b"", whole + b"x"])
    assert lines[0].startswith("1 1 0.0099999997")
    assert set(lines[1:]) == {"refused"}


def test_the_bridge_refuses_numbers_that_cannot_be_emitted(reader: Path) -> None:
    """Refuse intensities outside 0 to 1, values that are not finite, and too many points."""
    bad = [
        foci((0.0, 0.0, 0.2, 1.01)),
        foci((0.0, 0.0, 0.2, -0.1)),
        foci((0.0, np.nan, 0.2, 0.5)),
        foci((0.0, 0.0, np.inf, 0.5)),
        foci(*[(0.0, 0.0, 0.2, 0.5)] * 9),
    ]
    assert read_by(reader, [datagram(points) for points in bad]) == ["refused"] * len(bad)


def test_a_missing_bridge_is_explained() -> None:
    """Say how to build the bridge if it is not given or does not exist."""
    with pytest.raises(DeviceError, match=r"CMakeLists\.txt"):
        make_device("stratos_explore")
    device = make_device("stratos_explore:/no/such/bridge")
    with pytest.raises(DeviceError, match=r"cannot be started.*CMakeLists"):
        device.open(0.0)


def test_a_bridge_that_fails_is_quoted(tmp_path: Path) -> None:
    """Quote the bridge's message if there is no array."""
    script = tmp_path / "bridge"
    script.write_text("#!/bin/sh\necho failed no array is connected\n", encoding="utf-8")
    script.chmod(0o755)
    device = make_device(f"stratos_explore:{script}")
    with pytest.raises(DeviceError, match=re.escape("no array is connected")):
        device.open(0.0)
