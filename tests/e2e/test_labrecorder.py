"""The real LabRecorder (its own liblsl 1.17) records the outlets as they are."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import pyxdf

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

RECORD_S = 12.0
# A BioHarness 3 has no skin sensor, so this stream is there and stays empty.
EMPTY = {"st"}

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def _data_name(stream: dict[str, Any]) -> str:
    return stream["info"]["desc"][0]["biosensor"][0]["data_name"][0]


def _record(path: Path, count: int) -> dict[str, dict[str, Any]]:
    with LabRecorder(path, at_least=count):
        time.sleep(RECORD_S)
    streams, _ = _load_xdf(str(path))
    return {_data_name(stream): stream for stream in streams}


@pytest.mark.seam
def test_labrecorder_records_what_the_agent_declares(
    programs: Any,
    wait_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    declared = {stream.data_name: stream for stream in declaration("zephyr").streams}
    names = {*declared, "counters", "events", "markers"}
    source = SyntheticSource(seed=3, hrv_after_s=0)
    with SteeredBioHarness(source) as device:
        programs.agent(
            f'[[device]]\nsensor = "zephyr"\nunit = "SIM2"\nport = "{device.port}"\n'
            'participant = "p01"\n'
        )
        wait_until(lambda: len(device.sent) > 10, "a streaming device")
        recorded = _record(tmp_path / "study.xdf", len(names))
        status = programs.status()

    assert recorded.keys() == names
    for name, spec in declared.items():
        info = recorded[name]["info"]
        channels = info["desc"][0]["channels"][0]["channel"]
        assert [channel["label"][0] for channel in channels] == list(spec.labels)
        assert [channel["unit"][0] for channel in channels] == [c.unit for c in spec.channels]
        assert info["type"] == [spec.content_type]
        assert info["channel_format"] == [spec.format]
        assert ChannelFormat(info["channel_format"][0]) is not ChannelFormat.INT64
        assert info["source_id"] == [f"p01@zephyr-{name}"]
        assert float(info["nominal_srate"][0]) == pytest.approx(spec.rate)
        acquisition = info["desc"][0]["acquisition"][0]
        assert acquisition["model"] == ["BioHarness 3"]

    for name, stream in recorded.items():
        # pyxdf undoes clock offsets by these; two are the least that give a slope.
        assert len(stream["clock_times"]) >= 2, name
        stamps = np.asarray(stream["time_stamps"])
        assert (np.diff(stamps) >= 0).all(), name
        assert (len(stamps) == 0) == (name in EMPTY), name

    ecg = recorded["ecg"]
    assert float(ecg["info"]["effective_srate"]) == pytest.approx(250, rel=0.005)
    assert not any(counters["refused"] for counters in status["devices"][0]["streams"].values())
