"""Another project's client accepts the virtual Shimmer3 as it is.

Only where the environment of the peers is: ``BIOSENSOR_PEERS_PYTHON`` names its Python.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3
from biosensor_gateway.simulation.world import World

PEERS_PYTHON = os.environ.get("BIOSENSOR_PEERS_PYTHON", "")
PROGRAM = Path(__file__).parents[1] / "peers" / "pyshimmer_reads.py"
RESISTORS_KOHM = np.array([40.2, 287.0, 1000.0, 3300.0])

pytestmark = pytest.mark.skipif(not PEERS_PYTHON, reason="BIOSENSOR_PEERS_PYTHON is not set")


def read_by_peer(device: SimulatedShimmer3, *, dock: bool) -> dict[str, Any]:
    with subprocess.Popen(
        [PEERS_PYTHON, PROGRAM, device.port],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as peer:
        assert peer.stderr is not None
        assert peer.stderr.readline() == "streaming\n"
        if dock:
            device.dock()
        output, errors = peer.communicate("docked\n" if dock else "\n", timeout=60)
    assert peer.returncode == 0, errors
    return json.loads(output)


def power_the_probe(device: SimulatedShimmer3) -> None:
    """Do what the peer has no command for; it is kept in flash."""
    with serial.Serial(device.port, timeout=10) as port:
        port.write(bytes.fromhex("5e012104"))
        assert port.read(2) == b"\xff\xff"


# It takes the ACK before a pushed status for an answer, so the oldest is not docked.
@pytest.mark.parametrize(
    ("firmware", "dock"), [((0, 11, 0), False), ((0, 16, 11), True), ((1, 1, 2), True)]
)
def test_pyshimmer_reads_what_was_measured(firmware: tuple[int, int, int], dock: bool) -> None:
    with World() as world, SimulatedShimmer3(world, firmware=firmware, jitter_s=0.02) as device:
        power_the_probe(device)
        result = read_by_peer(device, dock=dock)
        gsr, ppg = device.truth.samples("gsr"), device.truth.samples("ppg")
        said_percent = device.truth.samples("bat").values[0, 0]
    assert result["firmware"] == ["LogAndStream", *firmware]
    assert result["name"] == "Shimmer_4E5F"
    assert result["battery_percent"] == pytest.approx(said_percent)
    assert result["rate_hz"] == 128
    assert result["inquiry"] == [128, 1, ["VBATT", "INTERNAL_ADC_13", "GSR_RAW"]]
    assert 0 <= result["rtc_s"] < 20
    assert result["status"] == [False, False, True, False, False, True, False, False]
    assert result["status_after"][1] is False
    docked_and_streaming = [True, True, True, False, True, True, False, False]
    assert result["pushed"] == ([docked_and_streaming] if dock else [])
    packets = np.array(result["packets"])
    assert set(np.diff(packets[:, 0]) % (1 << 24)) == {256}
    np.testing.assert_allclose(packets[:, 2] * 3000 / 4095, ppg.values[: len(packets), 0])
    gain = (packets[:, 3] & 0xFFF) * 6 / 4095 - 1
    conductance = gain * 1000 / RESISTORS_KOHM[packets[:, 3] >> 14]
    np.testing.assert_allclose(conductance, gsr.values[: len(packets), 0])
