"""What live features leave out is in the agent's status: with its stream, or with the agent."""

from __future__ import annotations

import asyncio
import json
import os
import time
from pathlib import Path

import pytest
from pylsl import local_clock

from biosensor_common.refusal import LATELY_S, Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import feature_refusals
from biosensor_gateway.agent.agent import problems_of, snapshot
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.feature_refusals import STALE_AFTER_S, FeatureRefusals
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.agent.status_file import write_status
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.cli import features
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.xdf.verdict import Colour, verdict
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.sink import DeviceSink
from tests.gateway.test_new_file import NoDriver
from tests.rigs.memory_links import MemoryOutlet
from tests.rigs.polling import until
from tests.xdf.test_participants import judged


def strap(patch: pytest.MonkeyPatch) -> Device:
    patch.setattr(outlets, "LslOutlet", MemoryOutlet)
    sink = DeviceSink(DeviceIdentity("polar_h10", "A1", "P01"), declaration("polar_h10"))
    sink.open(DeviceInfo(), {})
    return Device(Supervisor(NoDriver, sink), sink)


def told() -> Refusals:
    refusals = Refusals(clock=local_clock)
    why = "its timestamps stepped back once"
    refusals.refuse(Refusal.STAMPS_LEFT_OUT, 3, about="P01-polar_h10-A1-ecg", why=why)
    refusals.refuse(Refusal.NO_FEATURES, about="Pleth", why="stream 'Pleth' has no unit")
    return refusals


def test_it_stands_with_its_stream_or_with_the_agent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FeatureRefusals(tmp_path).write(told())
    device = strap(monkeypatch)
    # Two programs that send the same both tell of it, and once is enough.
    features = 2 * feature_refusals.read(tmp_path)
    status = snapshot([device], features=features)
    streams = status.devices[0].streams
    (of_stream,) = streams["P01@polar_h10-ecg"].refusals
    assert of_stream.sentence == "its live features: its timestamps stepped back once"
    assert (of_stream.what, of_stream.level, of_stream.now) == ("stamps_left_out", "warn", True)
    (of_agent,) = status.refusals
    assert of_agent.sentence == "live features of Pleth: stream 'Pleth' has no unit"


def test_a_recording_is_amber_with_what_heartbeats_tell_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FeatureRefusals(tmp_path).write(told())
    device = strap(monkeypatch)
    features = feature_refusals.read(tmp_path)
    problems = problems_of({"polar_h10/A1": device}, Refusals(), features, LATELY_S)
    stepped = "live features of P01-polar_h10-A1-ecg: its timestamps stepped back once"
    (of_device,) = problems["polar_h10/A1"]
    # It has passed, and a recording that begins later does not tell of it.
    assert of_device == {"what": stepped, "last": features[0].last_s}
    no_unit = "live features of Pleth: stream 'Pleth' has no unit"
    assert problems["gateway"] == [{"what": no_unit}]
    of_device["last"] = 1005.0
    states = {"polar_h10/A1": "streaming"}
    heartbeat: dict[str, object] = {"event": "heartbeat", "lsl_time": 1006.0, "devices": states}
    heartbeat["problems"] = problems
    report = judged("P01", device.sink.identity, events=[heartbeat, heartbeat])
    sentences = {each.text for each in report.findings if each.code == "refused"}
    assert sentences == {f"polar_h10/A1 of P01: {stepped}", no_unit}
    assert verdict(report).colour is Colour.AMBER


def test_of_who_has_withdrawn_heartbeats_tell_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FeatureRefusals(tmp_path).write(told())
    device = strap(monkeypatch)
    device.sink.pause()
    features = feature_refusals.read(tmp_path)
    problems = problems_of({"polar_h10/A1": device}, Refusals(), features, LATELY_S)
    assert problems.keys() == {"gateway"}


def test_it_is_over_when_its_program_has_ended(tmp_path: Path) -> None:
    mine = FeatureRefusals(tmp_path)
    mine.write(told())
    assert len(feature_refusals.read(tmp_path)) == 2
    mine.close()
    assert feature_refusals.read(tmp_path) == []


def test_what_a_killed_program_left_is_of_another_time_and_goes(tmp_path: Path) -> None:
    FeatureRefusals(tmp_path).write(told())
    path = tmp_path / f"features-{os.getpid()}.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"written": time.time() - STALE_AFTER_S - 1}))
    assert feature_refusals.read(tmp_path) == []
    assert not path.exists()


def test_without_a_word_there_is_no_file_and_a_damaged_one_does_no_harm(tmp_path: Path) -> None:
    FeatureRefusals(tmp_path).write(Refusals())
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "features-1.json").write_text("{")
    (tmp_path / "features-2.json").write_bytes(b"\xff")
    assert feature_refusals.read(tmp_path) == []


@pytest.mark.nightly
async def test_an_agent_that_goes_on_in_another_session_is_told_until_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    monkeypatch.setattr(features, "_LOOK_S", 0.01)
    refusals = Refusals()

    def sends_in(session: str) -> None:
        status = AgentStatus(session=session, written=time.time())
        write_status(tmp_path, status.model_dump())

    sends_in("lab7")
    looking = asyncio.create_task(features.watch_session(LslSettings(session_id="lab7"), refusals))
    await asyncio.sleep(0.1)
    assert not refusals.present
    sends_in("lab8")
    await until(lambda: refusals.present)
    assert "in the LSL session lab8" in refusals.present[0].sentence
    sends_in("lab7")
    await until(lambda: not refusals.present)
    looking.cancel()
