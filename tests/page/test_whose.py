"""The page asks whose data is recorded, and before a change costs a recording a sensor."""

from __future__ import annotations

import asyncio
import json
import tomllib
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.agent.status import AgentStatus, DeviceStatus
from biosensor_gateway.page.interface import Interface
from biosensor_gateway.page.session import Session, Shutdown
from tests.rigs.gateway import recording_going_on

STRAP = '[[device]]\nsensor = "polar_h10"\nunit = "A"\nparticipant = "{}"\nenabled = {}\n'
BELT = '[[device]]\nsensor = "zephyr"\nunit = "B"\nport = "COM4"\nparticipant = "{}"\n'
A = {"sensor": "polar_h10", "unit": "A"}
CONFIRMED = {"while_recording": True}


class Page:
    """The interface of the page, asked without a network."""

    def __init__(self, folder: Path, settings: str) -> None:
        self.settings = folder / "settings.toml"
        self.settings.write_text(settings)
        self.session = Session(folder, self.settings)
        self._app = Interface(self.session, Shutdown(self.session)).app

    def has_agent(self, *participants: str, virtual: bool = False) -> None:
        """Have an agent whose sensors these people wear."""
        devices = [_device(unit, worn) for unit, worn in zip("ABC", participants, strict=False)]
        self.session.take_status(AgentStatus(virtual=virtual, devices=devices))

    def ask(self, method: str, path: str, content: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        return asyncio.run(self.answer(method, path, json.dumps(content).encode()))

    def devices(self) -> list[dict[str, Any]]:
        return tomllib.loads(self.settings.read_text()).get("device", [])

    async def answer(self, method: str, path: str, body: bytes) -> tuple[int, dict[str, Any]]:
        scope = {
            "type": "http",
            "method": method,
            "path": f"/api/v1/{path}",
            "query_string": b"",
            "headers": [(b"content-type", b"application/json")],
        }
        sent: list[dict[str, Any]] = []

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": body}

        async def send(message: dict[str, Any]) -> None:
            sent.append(message)

        app: Any = self._app
        await app(scope, receive, send)
        answer = b"".join(each.get("body", b"") for each in sent)
        return sent[0]["status"], json.loads(answer)


def _device(unit: str, participant: str) -> DeviceStatus:
    return DeviceStatus(
        sensor="polar_h10" if unit == "A" else "zephyr", unit=unit, participant=participant,
        label="", state="streaming", paused=False, worn=None, connections=1, error=None,
        dropped_bytes=0, battery_percent=None, clock=None, streams={},
    )  # fmt: skip


@pytest.fixture
def page(tmp_path: Path) -> Page:
    return Page(tmp_path, STRAP.format("P01", "true") + BELT.format("P01"))


@pytest.fixture
def paused(tmp_path: Path) -> Page:
    """Without an enabled device, so that no agent is started."""
    return Page(tmp_path, STRAP.format("P01", "false"))


@pytest.fixture
def recording(tmp_path: Path) -> Generator[Path]:
    with recording_going_on(tmp_path) as file:
        yield file


def test_a_file_called_after_somebody_else_is_asked_about(page: Page, tmp_path: Path) -> None:
    page.has_agent("P01", "P01")
    code, answer = page.ask("POST", "recording/start", {"participant": "P02"})
    assert code == 409
    assert answer["problem"] == "The file is called P02, but its sensors are worn by P01."
    assert [(each["words"], each["more"]) for each in answer["choices"]] == [
        ("Set all sensors to P02, and record", {"set_sensors": True}),
        ("Record as it is", {"other_participants": True}),
    ]
    assert not page.session.recording.busy
    assert list(tmp_path.rglob("*.xdf")) == []


def test_what_one_person_cannot_wear_is_not_offered(tmp_path: Path) -> None:
    two_straps = STRAP.format("P01", "true") + BELT.format("P01") + BELT.format("P02")
    page = Page(tmp_path, two_straps.replace('unit = "B"', 'unit = "C"', 1))
    page.has_agent("P01", "P02")
    _, answer = page.ask("POST", "recording/start", {"participant": "P03"})
    assert [each["words"] for each in answer["choices"]] == ["Record as it is"]
    assert not page.session.status().one_wearer


def test_virtual_sensors_stand_in_no_settings(page: Page) -> None:
    page.has_agent("P01", virtual=True)
    _, answer = page.ask("POST", "recording/start", {"participant": "P03"})
    assert [each["words"] for each in answer["choices"]] == ["Record as it is"]
    code, answer = page.ask("PUT", "participant", {"participant": "P03"})
    assert (code, "virtual sensors" in answer["problem"]) == (400, True)


def test_one_field_sets_all_sensors(page: Page) -> None:
    assert page.session.status().one_wearer
    code, answer = page.ask("PUT", "participant", {"participant": "P02"})
    assert (code, answer["sentence"]) == (200, "All sensors are worn by P02 now.")
    assert [each["participant"] for each in page.devices()] == ["P02", "P02"]


@pytest.mark.parametrize(
    ("method", "path", "content"),
    [
        ("PATCH", "devices", {**A, "participant": "P02"}),
        ("PATCH", "devices", {**A, "label": "left"}),
        ("DELETE", "devices", A),
        ("POST", "devices", {"sensor": "polar_h10", "settings": {"unit": "Z", "enabled": False}}),
        ("PUT", "participant", {"participant": "P02"}),
    ],
)
def test_what_costs_a_recording_a_sensor_is_asked_about(
    method: str, path: str, content: dict[str, Any], paused: Page, recording: Path
) -> None:
    before = paused.settings.read_text()
    code, answer = paused.ask(method, path, content)
    assert (code, answer["title"]) == (409, "A recording is running")
    assert str(recording) in answer["problem"]
    (choice,) = answer["choices"]
    assert choice["more"] == CONFIRMED
    assert paused.settings.read_text() == before
    assert paused.ask(method, path, {**content, **CONFIRMED})[0] == 200


def test_what_changes_nothing_is_not_asked_about(paused: Page, recording: Path) -> None:
    assert recording.name
    unchanged = {**A, "participant": "P01", "label": ""}
    assert paused.ask("PATCH", "devices", unchanged)[0] == 200


def test_without_a_recording_nobody_is_asked(paused: Page) -> None:
    assert paused.ask("PATCH", "devices", {**A, "participant": "P02"})[0] == 200
    assert paused.devices()[0]["participant"] == "P02"


@pytest.mark.parametrize(
    ("method", "path", "more"),
    [
        ("PATCH", "devices", A),
        ("POST", "devices", {"sensor": "polar_h10", "settings": {"unit": "Z"}}),
        ("PUT", "participant", {}),
        ("POST", "recording/start", {}),
    ],
)
def test_one_sentence_for_a_name_that_cannot_be(
    method: str, path: str, more: dict[str, Any], paused: Page
) -> None:
    code, answer = paused.ask(method, path, {**more, "participant": "P-01"})
    assert code == 400
    assert answer["problem"] == (
        "'P-01' cannot be a participant's name: use 1 to 32 letters and digits, such as P01"
    )


def test_an_old_name_stays_until_it_is_changed(tmp_path: Path) -> None:
    page = Page(tmp_path, STRAP.format("P-01", "false"))
    code, _ = page.ask("PATCH", "devices", {**A, "participant": "P-01", "label": "left"})
    assert code == 200
    assert page.devices()[0]["label"] == "left"


@pytest.mark.parametrize("wrong", ["/data\0", "~nobody-of-that-name/data"])
@pytest.mark.parametrize(
    ("method", "path", "more"),
    [
        ("recording/start", "folder", {"participant": "P01"}),
        ("recordings/contents", "path", {}),
        ("replay/start", "path", {}),
    ],
)
def test_what_can_be_no_path_is_said(
    method: str, path: str, more: dict[str, Any], wrong: str, paused: Page
) -> None:
    code, answer = paused.ask("POST", method, {**more, path: wrong})
    assert code == 422
    assert answer["problem"].endswith(": nothing on this computer can have this name")


def test_what_is_added_is_said_by_its_name(paused: Page) -> None:
    settings = {"unit": "Z", "enabled": False}
    wanted = {"sensor": "polar_h10", "settings": settings, "participant": "P07"}
    code, answer = paused.ask("POST", "devices", wanted)
    assert code == 200
    assert answer["sentence"] == "P07's Polar H10 was added: its card appears when it streams."
