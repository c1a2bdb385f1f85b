# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of devices, the choice of a serial port, and the simulated device."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.haptics import TransducerArray, acoustic_field, solve_drive
from tactile_clay.haptics.devices import DeviceError, DeviceName, Emission, make_device, serial_port
from tactile_clay.haptics.devices.simulated import DeviceSimulated

words = st.text("abcXYZ0189_/.-", min_size=1, max_size=12)


@given(words, st.one_of(st.just(""), words), st.dictionaries(words, words, max_size=3))
def test_names_round_trip(kind: str, address: str, options: dict) -> None:
    """Parse kind, address and options."""
    parts = [address] if address else []
    parts += [f"{key}={value}" for key, value in options.items()]
    text = f"{kind}:{','.join(parts)}" if parts else kind
    assert DeviceName.parse(text) == DeviceName(kind, address, options)


def test_addresses_may_contain_colons() -> None:
    """Parse a Windows port, a path and a network address."""
    assert DeviceName.parse("openmpd:C:\\boards\\board_1.pat").address == "C:\\boards\\board_1.pat"
    assert DeviceName.parse("autd3:[::1]:42860").address == "[::1]:42860"


@given(st.text(max_size=30))
def test_any_text_is_read_or_refused(text: str) -> None:
    """Parse a name, or refuse it with an error that says what to write."""
    try:
        name = DeviceName.parse(text)
    except DeviceError as error:
        assert "NAME:ADDRESS" in str(error)
    else:
        assert name.kind


@pytest.mark.parametrize(
    ("plugged", "said"),
    [([], "Connected: none"), (["/dev/ttyUSB0", "/dev/ttyUSB1"], "ultraino:/dev/ttyUSB1")],
)
def test_a_port_must_be_given_unless_there_is_only_one(
    monkeypatch: pytest.MonkeyPatch, plugged: list[str], said: str
) -> None:
    """Use the only connected port, and ask for one if there is none or several."""
    ports = [SimpleNamespace(device=p, description="", hwid="", vid=1) for p in plugged]
    module = serial_port.load_pyserial()
    monkeypatch.setattr(module.tools.list_ports, "comports", lambda: ports)
    with pytest.raises(DeviceError, match=said):
        serial_port.choose_port("ultraino", "")
    assert serial_port.choose_port("ultraino", "COM3") == "COM3"
    ports[:] = [SimpleNamespace(device="COM4", description="", hwid="", vid=1)]
    assert serial_port.choose_port("ultraino", "") == "COM4"


@pytest.mark.parametrize("preset", TransducerArray.preset_names())
def test_a_simulated_array_gives_its_field_and_is_as_slow_as_the_real_one(preset: str) -> None:
    """Store the drive, give its field, be busy for a frame, and be silent after `off`."""
    device = make_device(f"simulated:{preset}")
    assert isinstance(device, DeviceSimulated)
    device.open(10.0)
    middle = device.array.working_volume.mean(axis=0)
    drive = solve_drive(device.array, middle[None], np.array((200.0,)))
    place = middle[None].astype(np.float32)
    sounds_at = device.emit(Emission(place, np.array((200.0,), np.float32), drive), 10.0)
    assert device.busy(10.0) == pytest.approx(sounds_at - 10.0)
    assert device.busy(sounds_at) == 0.0
    heard = device.field(middle[None])
    assert np.abs(heard) == pytest.approx(np.abs(acoustic_field(device.array, drive, middle[None])))
    assert np.abs(heard) == pytest.approx(200.0, rel=0.25)
    device.off(11.0)
    assert np.abs(device.field(middle[None])).max() == 0.0
    device.close(12.0)
