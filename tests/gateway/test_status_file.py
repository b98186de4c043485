"""The status file: written whole, read with doubt."""

from __future__ import annotations

import json
import math
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import UNWRITTEN_REPORTS, StatusWriter, snapshot
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink


class NoDriver:
    silence_limit_s = math.inf

    async def connect(self) -> Connected:
        raise NotImplementedError

    async def stream(self) -> None:
        raise NotImplementedError

    async def close(self) -> None:
        raise NotImplementedError


def status(age_s: float = 0.0, **more: object) -> dict[str, object]:
    return {"written": time.time() - age_s, "process": 1, "devices": [], **more}


def refusal(folder: Path) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        status_file.read_status(folder)
    return caught.value


def test_what_was_written_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "there" / "yet"
    written = status(devices=[{"sensor": "zephyr"}])
    status_file.write_status(folder, written)
    assert status_file.read_status(folder) == written
    assert [path.name for path in folder.iterdir()] == [status_file.STATUS_FILE]


@pytest.mark.parametrize("age_s", [None, 3600.0])
def test_an_agent_that_can_write_no_status_still_runs(tmp_path: Path, age_s: float | None) -> None:
    """Its disk is full: since its start, or since then."""
    if age_s is not None:
        status_file.write_status(tmp_path, status(age_s))
    with single_instance(tmp_path):
        error = refusal(tmp_path)
    assert error.reason is ConfigReason.UNREADABLE
    assert "an agent runs" in str(error)
    assert "disk" in str(error)
    assert refusal(tmp_path).reason is ConfigReason.NOT_FOUND


def test_no_file_means_no_agent(tmp_path: Path) -> None:
    error = refusal(tmp_path)
    assert error.reason is ConfigReason.NOT_FOUND
    assert "biosensor-gateway run" in str(error)


def test_an_old_file_means_no_agent(tmp_path: Path) -> None:
    status_file.write_status(tmp_path, status(age_s=60))
    error = refusal(tmp_path)
    assert error.reason is ConfigReason.NOT_FOUND
    assert "60 s ago" in str(error)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"written": "now"}', '{"written": null}', "\xff\xfe"]
)
def test_a_damaged_file_is_said_to_be_damaged(tmp_path: Path, text: str) -> None:
    (tmp_path / status_file.STATUS_FILE).write_text(text, encoding="latin-1")
    error = refusal(tmp_path)
    assert error.reason is ConfigReason.UNREADABLE
    assert str(tmp_path) in str(error)


@pytest.mark.parametrize(
    ("refusals", "said"),
    [(UNWRITTEN_REPORTS - 1, 0), (2 * UNWRITTEN_REPORTS, 1)],
)
def test_a_reader_in_the_way_is_no_trouble_until_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refusals: int, said: int
) -> None:
    """Windows refuses to replace a file that somebody reads."""
    writer, written = StatusWriter(tmp_path), status_file.write_status
    left = refusals

    def write(folder: Path, content: dict[str, Any]) -> None:
        nonlocal left
        left -= 1
        if left >= 0:
            raise PermissionError(13, "in use")
        written(folder, content)

    monkeypatch.setattr(status_file, "write_status", write)
    with capture_logs() as lines:
        for _ in range(2):
            for _ in range(refusals + 1):
                writer.write(status())
            left = refusals
    told = [each for each in lines if "cannot be written" in str(each["event"])]
    assert len(told) == said
    assert status_file.read_status(tmp_path)["devices"] == []


def test_removing_says_that_the_agent_has_ended(tmp_path: Path) -> None:
    status_file.write_status(tmp_path, status())
    status_file.remove_status(tmp_path)
    status_file.remove_status(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_removing_never_fails(tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    status_file.remove_status(in_the_way)
    with pytest.raises(OSError, match="state"):
        status_file.write_status(in_the_way, status())


def test_a_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    status_file.write_status(tmp_path, status(devices=["x" * 500_000]))
    ended = threading.Event()

    def write() -> None:
        while not ended.is_set():
            status_file.write_status(tmp_path, status(devices=["x" * 500_000]))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(50):
            assert len(status_file.read_status(tmp_path)["devices"][0]) == 500_000
    finally:
        ended.set()
        writer.join()


def test_a_snapshot_holds_every_device_and_stream_and_is_json(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("gateway", unit, "p01", "left"), declaration("gateway"))
    supervisor = Supervisor(NoDriver, sink)
    before = snapshot([Device(supervisor, sink)]).model_dump()["devices"][0]
    assert (before["state"], before["connections"]) == ("discovering", 0)
    assert (before["clock"], before["streams"]) == (None, {})
    sink.open(DeviceInfo(), {})
    sink.observe(1.0, 2.0)
    sink.dropped_bytes = 9
    sink.lost("events", 4)
    taken = snapshot([Device(supervisor, sink)]).model_dump()
    (device,) = json.loads(json.dumps(taken, allow_nan=False))["devices"]
    assert {key: device[key] for key in ("sensor", "unit", "participant", "label")} == {
        "sensor": "gateway", "unit": unit, "participant": "p01", "label": "left"
    }  # fmt: skip
    assert device["dropped_bytes"] == 9
    assert device["clock"]["offset_s"] == 1.0
    lost = {name: counters["lost"] for name, counters in device["streams"].items()}
    names = {"counters": 0, "events": 4, "markers": 0}
    assert lost == {f"p01@gateway.left-{name}": count for name, count in names.items()}
    sink.close()
