# SPDX-License-Identifier: GPL-3.0-or-later
"""AUTD3's own emulator of a device, in a separate process: ``state`` and ``reboot``."""

from __future__ import annotations

import json
import re
import sys

if __name__ == "__main__":
    sys.path.append(sys.argv[1])
    from autd3 import UdpEmulator

    emulator = UdpEmulator(1)
    # Its address is only available in the text of an option.
    found = re.search(r'"(.+)"', str(emulator.option().iface))
    assert found
    print(json.dumps({"port": found[1]}), flush=True)
    for line in sys.stdin:
        if line.strip() == "reboot":
            emulator.reboot(0)
        print(json.dumps({}), flush=True)
