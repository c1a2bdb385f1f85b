# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that starts an array server and sends to it until killed, as Blender may be."""

from __future__ import annotations

import json
import sys
import time

from tactile_clay.haptics import ArrayClient
from tactile_clay.tests.haptics.peers.harness import TWO_FOCI

if __name__ == "__main__":
    out = ArrayClient.start(sys.argv[1])
    assert out.process is not None
    print(json.dumps({"server": out.process.pid}), flush=True)
    while True:
        out.send(TWO_FOCI)
        time.sleep(1 / 60)
