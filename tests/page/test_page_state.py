"""What the page's server keeps and shows: state, values of now, logs, settings of LSL."""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
import traceback
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pylsl
import pytest
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ConfigError
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl_header import append_children, describe, read_header
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent.device_states import chosen, described
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.agent.status import AgentStatus, DeviceFacts, DeviceStatus, StreamStatus
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.features.sources import judge, stream_info
from biosensor_gateway.page import interface
from biosensor_gateway.page.agent_client import Viewer
from biosensor_gateway.page.auth import ViewKeys
from biosensor_gateway.page.interface import Features
from biosensor_gateway.page.live_feed import HOLDS_S, History, is_of_now
from biosensor_gateway.page.models import AgentState, DeviceView, StreamView
from biosensor_gateway.page.routes import devices
from biosensor_gateway.page.routes.api import misformed
from biosensor_gateway.page.routes.devices import MOST_BYTES, MOST_LINES, last_lines
from biosensor_gateway.page.routes.recording import NewRecording, Recorder
from biosensor_gateway.page.session import STARTING_S, Session
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    RecordingRequest,
)
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.page.conftest import DEADLINE_S, Server
from tests.rigs.polling import until

# What the page's server keeps between requests.


def test_settings_that_cannot_be_read_do_not_fill_the_memory(tmp_path: Path) -> None:
    # They are asked for with each status, twice a second for each window.
    path = tmp_path / "settings.toml"
    path.write_text("nonsense")
    session = Session(tmp_path, path)

    def frames() -> int:
        with pytest.raises(ConfigError) as caught:
            session.loaded()
        return len(traceback.extract_tb(caught.value.__traceback__))

    first = frames()
    for _ in range(10):
        session.status()
    assert frames() == first


@pytest.mark.parametrize(
    ("place", "said"),
    [(("body", "rest"), "rest: wrong word"), (("body",), "the request: wrong word")],
)
async def test_a_request_with_wrong_content_is_refused_with_its_place(
    place: tuple[str, ...], said: str
) -> None:
    wrong = RequestValidationError([{"loc": place, "msg": "wrong word", "type": "literal"}])
    answer = await misformed(Request({"type": "http"}), wrong)
    assert answer.status_code == 422
    assert json.loads(bytes(answer.body))["problem"] == said


def test_only_the_token_of_the_view_opens_it() -> None:
    keys = ViewKeys(8000)
    cookie = keys.cookie_for(keys.token)
    assert cookie is not None
    assert keys.fits(cookie)
    assert keys.cookie_for(keys.token + "x") is None
    assert not keys.fits(cookie + "x")


async def test_an_agent_that_was_started_is_waited_for_and_then_is_absent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(tmp_path, tmp_path / "settings.toml")
    assert session.agent is AgentState.ABSENT
    session.note_start()
    assert session.agent is AgentState.STARTING
    later_s = time.monotonic() + STARTING_S
    monkeypatch.setattr(time, "monotonic", lambda: later_s)
    assert session.agent is AgentState.ABSENT


# A value that is not of now is not shown.
NOW = 500.0
STRAP = DeviceIdentity("polar_h10", "A1", "P01")
SPEC = declaration("polar_h10")


STREAM = StreamStatus(
    pushed=1, lost=4, refused=0, last_stamp=NOW, withheld=0, waited=0, nominal_hz=130.0,
    silent=False,
)  # fmt: skip
USUAL: dict[str, Any] = {
    "sensor": "polar_h10", "unit": "A1", "participant": "P01", "label": "",
    "state": "streaming", "paused": False, "worn": True, "connections": 1, "error": None,
    "dropped_bytes": 0, "battery_percent": 80.0, "clock": None,
}  # fmt: skip


class Agent:
    """An agent with one strap that has sent everything once, some time ago."""

    def __init__(self, age_s: float = 1.0) -> None:
        self._history = History()
        self._viewer = Viewer(self._history)
        for stream in SPEC.streams:
            samples = Samples(
                source_id(STRAP, stream.data_name),
                np.array([NOW - age_s]),
                np.full((1, len(stream.channels)), 72.0, np.float32),
            )
            self._history.add(samples)

    def shows(self, **changes: Any) -> DeviceView:
        rates = {
            e.data_name: e.rate if isinstance(e.rate, int | float) else 130.0 for e in SPEC.streams
        }
        streams = {
            source_id(STRAP, name): STREAM.model_copy(update={"nominal_hz": rate})
            for name, rate in rates.items()
        }
        device = DeviceStatus.model_validate({**USUAL, "streams": streams, **changes})
        (shown,) = self._viewer.devices(AgentStatus(lsl_time=NOW, devices=[device]))
        return shown


def stream(device: DeviceView, data_name: str) -> StreamView:
    return device.streams[source_id(STRAP, data_name)]


def test_of_a_device_that_streams_all_is_shown() -> None:
    shown = Agent().shows()
    assert shown.is_sending
    assert (shown.lost, shown.battery_percent, shown.worn) == (4 * len(SPEC.streams), 80.0, True)
    assert all(each.is_fresh and each.values for each in shown.streams.values())


@pytest.mark.parametrize(
    "away",
    [
        {"paused": True},
        *({"state": state} for state in ("discovering", "connecting", "backoff", "stopped")),
    ],
)
def test_of_a_device_that_does_not_nothing_is(away: dict[str, Any]) -> None:
    shown = Agent().shows(**away)
    assert not shown.is_sending
    assert (shown.lost, shown.battery_percent, shown.worn) == (None, None, None)
    for each in shown.streams.values():
        assert (each.is_fresh, each.values, each.measured_hz) == (False, [], None)


def test_a_heart_rate_of_before_is_not_that_of_now_and_a_battery_holds() -> None:
    shown = Agent(age_s=HOLDS_S + 1).shows()
    for name in ("hr", "ibi", "ecg"):
        assert not stream(shown, name).is_fresh
    assert stream(shown, "bat").values == [72.0]


def test_a_slow_stream_is_of_now_until_its_next_sample_is_overdue() -> None:
    assert is_of_now(20.0, nominal_hz=0.1, is_signal=True)
    assert not is_of_now(31.0, nominal_hz=0.1, is_signal=True)
    assert not is_of_now(6.0, nominal_hz=130.0, is_signal=True)
    meter = RateMeter(0.1)
    meter.note(1, 0.0)
    meter.note(2, 10.0)
    assert meter.rate_hz(19.0) == pytest.approx(0.1)


def test_what_was_sent_before_the_page_is_not_nothing_yet() -> None:
    agent = Agent()
    agent._history.keep_only(())  # pyright: ignore[reportPrivateUsage]
    battery = stream(agent.shows(), "bat")
    assert (battery.age_s, battery.values) == (0.0, [])


def test_a_virtual_device_of_each_of_two_people_is_another_one() -> None:
    usual: dict[str, Any] = {
        "sensor": "polar_h10", "unit": "virtual", "label": "", "state": "streaming",
        "paused": False, "worn": True, "connections": 1, "error": None, "dropped_bytes": 0,
        "battery_percent": None, "clock": None, "streams": {},
    }  # fmt: skip
    two = [DeviceStatus(participant=each, **usual) for each in ("P01", "P02")]
    views = Viewer(History()).devices(AgentStatus(lsl_time=NOW, devices=two))
    assert [each.name for each in views] == ["polar_h10/virtual (P01)", "polar_h10/virtual (P02)"]
    # The commands know it by that name.
    for each in two:
        worn = DeviceIdentity(each.sensor, each.unit, each.participant)
        known = [DeviceIdentity(one.sensor, one.unit, one.participant) for one in two]
        assert chosen(described(worn), known) == worn


# The end of the log of one device, whatever else is in the file.


def record(event: str, unit: str = "A", **facts: object) -> str:
    about = {"sensor": "zephyr", "unit": unit, "level": "warning"}
    when = {"timestamp": "2026-05-04T10:20:30.000000Z", "logger": "biosensor_gateway.agent"}
    return json.dumps({"event": event, **about, **when, **facts}) + "\n"


ZEPHYR = DeviceIdentity("zephyr", "A", "P01")
"""A real one, whose lines do not name who wears it."""


def sentences(folder: Path) -> list[str]:
    return [each.sentence for each in last_lines(folder, ZEPHYR).lines]


def test_the_newest_of_the_device_come_first_with_their_facts(tmp_path: Path) -> None:
    log = tmp_path / LOG_FILE_NAME
    log.write_text(
        record("connected", firmware="1.2", reason="hidden")
        + record("connected", unit="B")
        + record("lost\x1b[31m", samples=3)
    )
    (line, _) = last_lines(tmp_path, ZEPHYR).lines
    assert sentences(tmp_path) == ["lost\\x1b[31m (samples 3)", "connected (firmware 1.2)"]
    assert (line.level, line.time) == ("warning", "2026-05-04T10:20:30.000000Z")
    assert last_lines(tmp_path, DeviceIdentity("polar_h10", "A")).lines == []


def test_a_file_that_has_just_been_filled_is_read_on(tmp_path: Path) -> None:
    (tmp_path / LOG_FILE_NAME).write_text(record("new"))
    (tmp_path / f"{LOG_FILE_NAME}.1").write_text(record("old"))
    assert sentences(tmp_path) == ["new", "old"]


def test_of_a_long_file_the_end_is_read(tmp_path: Path) -> None:
    assert sentences(tmp_path) == []
    lines = [record(f"event {each}") for each in range(5000)]
    (tmp_path / LOG_FILE_NAME).write_text("".join(lines))
    assert sum(map(len, lines)) > MOST_BYTES
    assert sentences(tmp_path) == [f"event {each}" for each in range(4999, 4999 - MOST_LINES, -1)]
    (tmp_path / LOG_FILE_NAME).write_text(record("x" * 100_000))
    assert len(sentences(tmp_path)[0]) < 500


@given(st.lists(st.binary(max_size=60) | st.sampled_from([b"[]", b"1", b'{"sensor": ["zephyr"]}'])))
def test_whatever_else_is_in_the_file_is_passed_over(noise: list[bytes]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        content = b"\n".join([*noise, record("here").encode(), *noise])
        (Path(folder) / LOG_FILE_NAME).write_bytes(content)
        assert sentences(Path(folder)) == ["here"]


# What the page records and streams for a trial is in the LSL session of the settings.
SETTINGS = '[lsl]\nsession_id = "lab7"\nknown_peers = ["192.168.1.20"]\n'


def test_a_recording_looks_where_the_settings_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[LslOverrides] = []

    def start(_self: LocalRecorder, _request: RecordingRequest, settings: GatewaySettings) -> None:
        told.append(settings.lsl.overrides)
        raise RecorderError(RecorderReason.NOT_BEGUN, "not in this test")

    monkeypatch.setattr(LocalRecorder, "start", start)
    settings = tmp_path / "settings.toml"
    settings.write_text(SETTINGS)

    async def nobody(_participant: str) -> None:
        return None

    recording = Recorder(Session(tmp_path, settings), nobody)
    wanted = NewRecording(participant="p01", session="S001", task="rest", folder=str(tmp_path))
    with pytest.raises(RecorderError, match="not in this test"):
        asyncio.run(recording.start(wanted))
    assert told == [LslOverrides("lab7", ("192.168.1.20",))]


class SeenFeatures:
    """In place of the reader of the network: a heart rate of somebody's strap is there."""

    wanted = frozenset[str]()

    def __init__(self, *_: object) -> None:
        stream = SimpleNamespace(derived_from="P01@polar_h10-ecg")
        self.view = SimpleNamespace(devices=[SimpleNamespace(streams=[stream])])

    def stop(self) -> None:
        pass


@asynccontextmanager
async def _with_features(session: Session) -> AsyncGenerator[None]:
    reading = asyncio.create_task(Features(session).run())
    try:
        yield
    finally:
        reading.cancel()
        await asyncio.wait([reading])


def _said(session: Session) -> list[str]:
    return [each.sentence for each in session.unshown if each.now]


@pytest.mark.nightly
async def test_features_are_of_the_agent_s_session_whatever_the_settings_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another group's strap may have the same source_id."""
    told: list[LslOverrides] = []
    monkeypatch.setattr(interface, "configure_lsl", told.append)
    monkeypatch.setattr(interface, "Reader", SeenFeatures)
    settings = tmp_path / "settings.toml"
    settings.write_text(SETTINGS)
    session = Session(tmp_path, settings)
    session.take_status(AgentStatus(session="before"))
    async with _with_features(session):
        await until(lambda: session.features)
        assert not _said(session)
        session.take_status(AgentStatus(session="lab7"))
        await until(lambda: not session.features)
        session.take_status(AgentStatus(session="lab7"))
        (shown,) = session.status().refusals
        assert shown.now
        assert "live features of this agent: they are not shown" in shown.sentence
        assert "lab7" in shown.sentence
        assert "looks in before" in shown.sentence
        session.take_status(AgentStatus(session="before"))
        await until(lambda: session.features and not _said(session))
    assert [each.session_id for each in told] == ["before"]


@pytest.mark.nightly
async def test_features_of_a_stream_that_two_agents_send_are_not_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody knows of which agent they are."""
    monkeypatch.setattr(interface, "configure_lsl", lambda _overrides: None)  # pyright: ignore[reportUnknownLambdaType, reportUnknownArgumentType]
    strap = DeviceIdentity("polar_h10", f"{time.time_ns():X}", "P01")
    (ecg,) = (each for each in SPEC.streams if each.data_name == "ecg")
    raw = pylsl.StreamInfo("P01-ecg", "ECG", 1, 130.0, "float32", source_id(strap, "ecg"))
    append_children(raw.desc(), describe(ecg, strap, DeviceInfo()))
    source = judge(raw.name(), raw.source_id(), read_header(raw.as_xml()))
    assert source is not None
    session = Session(tmp_path, tmp_path / "none.toml")
    own: dict[str, Any] = {"unit": strap.unit, "streams": {raw.source_id(): STREAM}}
    session.take_status(AgentStatus(devices=[DeviceStatus.model_validate({**USUAL, **own})]))
    outlets = [pylsl.StreamOutlet(each) for each in (raw, stream_info(source, source.features[1]))]
    async with _with_features(session):
        await until(lambda: session.features)
        assert not _said(session)
        outlets.append(pylsl.StreamOutlet(raw))
        await until(lambda: not session.features)
        (why,) = _said(session)
        assert why.startswith("P01-ecg: they are not shown, because they may be another person's")
        assert "2 agents" in why
        outlets.pop()
        await until(lambda: session.features)
        assert not _said(session)


@pytest.mark.parametrize("virtual", [True, False])
def test_an_agent_has_the_settings_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, virtual: bool
) -> None:
    """Also one of virtual devices, and where there is no such file yet."""
    begun: list[tuple[Any, ...]] = []
    note: Callable[..., None] = lambda *arguments: begun.append(arguments)  # noqa: E731
    monkeypatch.setattr(devices, "start_beside", note)
    settings = tmp_path / "mine.toml"
    devices.start_agent(tmp_path, settings, virtual=virtual)
    ((words, environment),) = begun
    assert environment == {"BIOSENSOR_GATEWAY_SETTINGS": str(settings)}
    assert ("--settings" in words) is not virtual
    assert ("--simulate" in words) is virtual


# What the API says of the agent is what ``status --json`` says, by the same models.


Entries = dict[str, Any]
# Counted, or measured again each second; all else stays the same while all is well.
CHANGING = {
    *("written", "lsl_time"),
    *("offset_s", "drift_ppm", "residual_rms_s", "observations", "newest_s"),
    *("pushed", "waited", "last_stamp", "battery_percent"),
}


@pytest.mark.nightly
def test_status_json_and_the_api_say_the_same_of_a_running_agent(server: Server) -> None:
    cookie = server.enter()
    server.programs.start("run", "--no-ask", "--simulate", "zephyr,polar_h10")
    in_api = streaming(server, cookie)
    in_command = told_by_command(server)
    # Something may happen to a device between the two.
    deadline = time.monotonic() + DEADLINE_S
    while steady(in_command, in_command) != steady(in_api, in_command):
        assert time.monotonic() < deadline, (in_command, in_api)
        in_api, in_command = streaming(server, cookie), told_by_command(server)
    assert in_command["process"] and len(in_command["devices"]) == 2

    schemas = json.loads(server.request("GET", "/api/v1/openapi.json", cookie).body)["components"]
    for view, model in (("DeviceView", DeviceFacts), ("StreamView", StreamStatus)):
        told = schemas["schemas"][view]["properties"]
        for name, schema in model.model_json_schema()["properties"].items():
            assert told[name].get("type") == schema.get("type"), name


def told_by_command(server: Server) -> Entries:
    told: Entries = json.loads(server.programs.call("status", "--json"))
    AgentStatus.model_validate(told)
    return told


def streaming(server: Server, cookie: str) -> Entries:
    """Wait until both devices stream, with a clock, and return what the API says then."""
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        told = json.loads(server.request("GET", "/api/v1/status", cookie).body)
        devices = told["devices"]
        if len(devices) == 2 and all(
            each["state"] == "streaming" and each["clock"] and each["battery_percent"]
            for each in devices
        ):
            return told
        time.sleep(0.2)
    raise AssertionError("two devices never streamed")


def steady(told: Entries, model: Entries) -> Entries:
    """Return the entries that another one has, too, without those that change by themselves."""
    kept: Entries = {}
    for name, here in model.items():
        if name == "declared":
            # The API says it with each stream.
            continue
        there = told[name]
        if isinstance(here, dict):
            there = steady(there, cast("Entries", here))
        elif name == "devices":
            there = [steady(*each) for each in zip(there, here, strict=True)]
        if name not in CHANGING:
            kept[name] = there
    return kept
