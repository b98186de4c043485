"""BrainFlow reads from a virtual EmotiBit what it measured; see :mod:`tests.peers.test_peers`."""

from __future__ import annotations

import os
import random
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.peers.test_peers import KEY, laboratory, peer, result

pytestmark = pytest.mark.nightly

DEVICE = "MD-V5-0000321"
PORT = 3131
"""The client knows no other one."""


@pytest.mark.skipif(sys.platform != "linux", reason="only there each loopback address is one's own")
def test_brainflow_reads_the_emotibit(tmp_path: Path) -> None:
    # Others may have a device on the same port, on this computer.
    dice = random.Random(os.urandom(8))
    address = f"127.{dice.randrange(1, 255)}.{dice.randrange(1, 255)}.{dice.randrange(1, 255)}"
    with laboratory(tmp_path, "emotibit", device=DEVICE, host=address, port=PORT) as lab:
        with peer(lab, "brainflow_reads_emotibit.py", address, DEVICE) as process:
            read = result(process)
        truth = lab.truth(KEY)
    for name in ("acc", "gyro", "mag", "ppg", "eda"):
        sent = truth[name].values
        assert 50 <= len(read[name]) <= len(sent), name
        np.testing.assert_allclose(read[name], sent[: len(read[name])], rtol=0, atol=1e-9)
