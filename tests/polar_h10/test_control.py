"""The PMD control point: commands and replies against vectors, in any order, and errors."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import (
    CredentialError,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.polar_h10.driver import Plan, PolarDriver, PolarSession
from biosensor_gateway.devices.polar_h10.driver.control import ControlPoint, Wanted
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    CONTROL_POINT,
    Measurement,
    Reply,
    Setting,
    Status,
    Stopped,
    choose,
    get_settings,
    parse_features,
    parse_indication,
    parse_settings,
    start,
    stop,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import DATA
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_errors import AttError, Pairing
from biosensor_gateway.transports.nearby import Advertisement

# Orders of replies, and errors, that no virtual device produces: with a scripted link.

ASK = get_settings(Measurement.ACCELERATION)
RATES = "f0010200 00 00 04 1900 3200 6400 c800"
SILENT = TransportError(TransportReason.SILENT, "no answer")
LOST = TransportError(TransportReason.LOST, "cut")


class ScriptedLink:
    """Answers each write with what its script has next; see :class:`BleLink`."""

    what = "Polar H10 A1B2C3D4"

    clock = LSL_CLOCK

    def __init__(self, *script: Sequence[str] | GatewayError) -> None:
        self.script = list(script)
        self.written: list[str] = []
        self.paired = False
        self.closed = False
        self._incoming: asyncio.Queue[Notification] = asyncio.Queue()

    def say(self, uuid: str, text: str) -> None:
        self._incoming.put_nowait(Notification(uuid, bytes.fromhex(text), 0.0))

    async def open(self) -> Advertisement:
        return Advertisement("A0:9E:1A:00:00:01", "Polar H10 A1B2C3D4", -50)

    async def pair(self) -> None:
        self.paired = True

    def has(self, uuid: str) -> bool:
        return uuid in {CONTROL_POINT, DATA}

    def properties(self, uuid: str) -> frozenset[str]:
        return frozenset()

    async def read(self, uuid: str) -> bytes:
        return bytes.fromhex("0f0100")

    async def subscribe(self, uuid: str) -> None: ...

    async def unsubscribe(self, uuid: str) -> None: ...

    async def write(self, uuid: str, data: bytes) -> None:
        self.written.append(data.hex())
        step = self.script.pop(0) if self.script else ()
        if isinstance(step, GatewayError):
            raise step
        for text in step:
            self.say(CONTROL_POINT, text)

    async def next(self) -> Notification:
        return await self._incoming.get()

    async def close(self) -> None:
        self.closed = True


@asynccontextmanager
async def control_of(
    link: ScriptedLink,
) -> AsyncGenerator[tuple[ControlPoint, list[Notification]]]:
    passed_on: list[Notification] = []

    async def receive() -> list[Notification]:
        return [await link.next()]

    control = ControlPoint(cast("BleLink", link), receive)
    control.dialogue.begin()
    streaming = asyncio.create_task(control.dialogue.stream(passed_on.extend))
    yield control, passed_on
    streaming.cancel()
    await control.dialogue.close()


def driver_of(*links: ScriptedLink) -> PolarDriver:
    emitter = PolarEmitter(
        DeviceSink(DeviceIdentity("polar_h10", "scripted"), declaration("polar_h10"))
    )
    wanted = [Wanted(Measurement.ECG, {Setting.SAMPLE_RATE: 130})]
    rest = iter(links)

    def meet() -> PolarSession:
        return PolarSession(cast("BleLink", next(rest)), emitter, Plan(lambda _: wanted))

    return PolarDriver(meet, Pairing(), emitter, frozenset({"acc"}))


@pytest.mark.usefixtures("virtual_clock")
async def test_a_reply_may_come_in_several_packets() -> None:
    link = ScriptedLink(["f0010200 01 00 02 1900", "f0010200 00 3200"])
    async with control_of(link) as (control, _):
        reply = await control.request(ASK)
    assert parse_settings(reply.parameters) == {Setting.SAMPLE_RATE: (25, 50)}
    assert not reply.more


@pytest.mark.usefixtures("virtual_clock")
async def test_only_the_reply_to_the_command_is_taken() -> None:
    foreign = ["0f05000000", "f0010000000001 8200", "f0020200", "0102", "", "f0"]
    async with control_of(ScriptedLink([*foreign, RATES])) as (control, passed_on):
        reply = await control.request(ASK)
    assert parse_settings(reply.parameters) == {Setting.SAMPLE_RATE: (25, 50, 100, 200)}
    assert [each.data for each in passed_on[:-1]] == [bytes.fromhex(text) for text in foreign]


@pytest.mark.usefixtures("virtual_clock")
async def test_data_that_come_before_the_reply_are_passed_on() -> None:
    link = ScriptedLink([RATES])
    async with control_of(link) as (control, passed_on):
        link.say(DATA, "00" * 13)
        await control.request(ASK)
    first, _ = passed_on
    assert (first.uuid, len(first.data)) == (DATA, 13)


@pytest.mark.usefixtures("virtual_clock")
async def test_a_late_reply_does_not_answer_for_the_next_command() -> None:
    link = ScriptedLink([], [RATES])
    async with control_of(link) as (control, _):
        with pytest.raises(ProtocolError) as caught:
            await control.request(ASK)
        assert caught.value.reason is ProtocolReason.NO_REPLY
        link.say(CONTROL_POINT, "f0010206")
        assert (await control.request(ASK)).status == 0


@pytest.mark.usefixtures("virtual_clock")
async def test_what_a_reply_changes_holds_for_the_data_behind_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link = ScriptedLink([RATES])
    async with control_of(link) as (control, passed_on):
        before: list[int] = []

        async def write(uuid: str, data: bytes) -> None:
            del uuid, data
            link.say(DATA, "00" * 13)
            link.say(CONTROL_POINT, RATES)
            link.say(DATA, "01" * 13)

        monkeypatch.setattr(link, "write", write)
        await control.request(ASK, lambda _: before.append(len(passed_on)))
    assert before == [1]
    assert [each.uuid for each in passed_on] == [DATA, CONTROL_POINT, DATA]


STARTED = (["f0010000 00 00 01 8200 01 01 0e00"], ["f0020000 00"])


@pytest.mark.usefixtures("virtual_clock")
@pytest.mark.parametrize(
    "error",
    [AttError(0x05, "H10"), AttError(0x0F, "H10"), AttError(0x0E, "H10"), SILENT],
    ids=lambda error: f"{getattr(error, 'code', error.reason)}",
)
async def test_the_first_command_tells_that_pairing_is_due(error: GatewayError) -> None:
    first, second = ScriptedLink(error), ScriptedLink(*STARTED)
    connected = await driver_of(first, second).connect()
    assert connected.rates == {"ecg": 130}
    assert (first.paired, first.closed, second.paired) == (False, True, True)


@pytest.mark.usefixtures("virtual_clock")
@pytest.mark.parametrize(
    ("script", "raised"),
    [
        ([LOST], LOST),
        ([AttError(0x06, "H10")], None),
        # Not the first command any more: this one has other causes.
        ([STARTED[0], AttError(0x0E, "H10")], None),
        ([STARTED[0], SILENT], SILENT),
    ],
)
async def test_other_failures_have_nothing_to_do_with_pairing(
    script: list[Sequence[str] | GatewayError], raised: GatewayError | None
) -> None:
    link = ScriptedLink(*script)
    with pytest.raises(GatewayError) as caught:
        await driver_of(link).connect()
    assert caught.value is raised or isinstance(caught.value, AttError)
    assert not link.paired


@pytest.mark.usefixtures("virtual_clock")
@pytest.mark.parametrize(
    ("error", "kind"), [(AttError(0x05, "H10"), CredentialError), (SILENT, ProtocolError)]
)
async def test_pairing_that_does_not_help_is_not_repeated(
    error: GatewayError, kind: type[GatewayError]
) -> None:
    links = ScriptedLink(error), ScriptedLink(error)
    with pytest.raises(kind, match="remove the sensor in the system's Bluetooth settings"):
        await driver_of(*links).connect()


@pytest.mark.usefixtures("virtual_clock")
async def test_an_error_after_pairing_stays_what_it_is() -> None:
    links = ScriptedLink(AttError(0x05, "H10")), ScriptedLink(LOST)
    with pytest.raises(TransportError) as caught:
        await driver_of(*links).connect()
    assert caught.value is LOST


@pytest.mark.usefixtures("virtual_clock")
@pytest.mark.parametrize("hang", ["write", "unsubscribe"])
async def test_closing_waits_for_nothing(hang: str, monkeypatch: pytest.MonkeyPatch) -> None:
    link = ScriptedLink(*STARTED)
    driver = driver_of(link)
    await driver.connect()
    forever: Callable[..., object] = lambda *_: asyncio.sleep(3600)  # noqa: E731
    monkeypatch.setattr(link, hang, forever)
    async with asyncio.timeout(20):
        await driver.close()
    assert link.closed


@pytest.mark.usefixtures("virtual_clock")
async def test_closing_tells_the_device_to_stop() -> None:
    link = ScriptedLink(*STARTED)
    driver = driver_of(link)
    await driver.connect()
    await driver.close()
    assert link.written == ["0100", "02000001820001010e00", "0300"]


# Commands and replies of the PMD control point, against vectors and against any bytes.
_FOLDER = Path(__file__).parent / "vectors"
VECTORS: list[dict[str, Any]] = [
    vector
    for name in ("polar_pmd_h10.json", "polar_pmd_verity.json")
    for vector in json.loads((_FOLDER / name).read_text(encoding="utf-8"))
]
REPLIES = [
    vector for vector in VECTORS if vector["kind"] == "control_point" and "op" in vector["expected"]
]
FEATURES = [vector for vector in VECTORS if "features" in vector["expected"]]
COMMANDS = {vector["name"]: vector["hex"] for vector in VECTORS if vector["kind"] == "command"}
NEVER_SENT = {"cmd_measurement_status", "cmd_start_sdk_mode"}
SETTING_NAMES = {
    "sample_rate": Setting.SAMPLE_RATE,
    "resolution": Setting.RESOLUTION,
    "range": Setting.RANGE,
    "factor": Setting.FACTOR,
}
ACC_OFFER = {
    Setting.SAMPLE_RATE: (25, 50, 100, 200),
    Setting.RESOLUTION: (16,),
    Setting.RANGE: (2, 4, 8),
}


def acc(rate: int, range_g: int) -> dict[Setting, int]:
    return {Setting.RANGE: range_g, Setting.SAMPLE_RATE: rate, Setting.RESOLUTION: 16}


@pytest.mark.parametrize("vector", FEATURES, ids=lambda vector: vector["name"])
def test_features_vector(vector: dict[str, Any]) -> None:
    assert sorted(parse_features(bytes.fromhex(vector["hex"]))) == vector["expected"]["features"]


@pytest.mark.parametrize("vector", REPLIES, ids=lambda vector: vector["name"])
def test_reply_vector(vector: dict[str, Any]) -> None:
    reply = parse_indication(bytes.fromhex(vector["hex"]))
    assert isinstance(reply, Reply)
    expected = vector["expected"]
    assert (reply.operation, reply.measurement) == (expected["op"], expected["type"])
    assert Status(reply.status).name == reply.status_text == expected["status"]
    assert reply.more == expected["more"]
    if "params_hex" in expected:
        assert reply.parameters.hex() == expected["params_hex"]
        settings = parse_settings(reply.parameters)
        assert settings.keys() == {SETTING_NAMES[name] for name in expected["settings"]}
        for name, values in expected["settings"].items():
            assert list(settings[SETTING_NAMES[name]]) == pytest.approx(values, rel=1e-6)


BUILT = {
    "cmd_get_ecg_settings": get_settings(Measurement.ECG),
    "cmd_get_acc_settings": get_settings(Measurement.ACCELERATION),
    "cmd_start_ecg_130_14": start(
        Measurement.ECG, {Setting.SAMPLE_RATE: 130, Setting.RESOLUTION: 14}
    ),
    "cmd_start_acc_200_16_8g": start(Measurement.ACCELERATION, acc(200, 8)),
    "cmd_start_acc_25_16_2g": start(Measurement.ACCELERATION, acc(25, 2)),
    "cmd_stop_ecg": stop(Measurement.ECG),
    "cmd_stop_acc": stop(Measurement.ACCELERATION),
    "cmd_start_ppi": start(Measurement.PULSE_INTERVALS, {}),
    "cmd_start_ppg_55_22_4ch": start(
        Measurement.PPG, {Setting.SAMPLE_RATE: 55, Setting.RESOLUTION: 22, Setting.CHANNELS: 4}
    ),
}


@pytest.mark.parametrize("name", sorted(COMMANDS.keys() - NEVER_SENT))
def test_command_vector(name: str) -> None:
    assert BUILT[name].hex() == COMMANDS[name]


def test_a_reply_may_be_shorter_than_its_fields_and_have_an_unknown_status() -> None:
    reply = parse_indication(bytes.fromhex("f00200c8"))
    assert isinstance(reply, Reply)
    assert (reply.status, reply.more, reply.parameters) == (200, False, b"")
    assert "200" in reply.status_text


def test_the_device_may_stop_measurements_by_itself() -> None:
    assert parse_indication(bytes.fromhex("010002")) == Stopped((0, 2))


@pytest.mark.parametrize("text", ["", "0f0500", "f0", "f00200", "02"])
def test_anything_else_is_no_indication(text: str) -> None:
    assert parse_indication(bytes.fromhex(text)) is None


@pytest.mark.parametrize("text", ["", "0f", "0f05", "f00500"])
def test_without_features_nothing_is_offered(text: str) -> None:
    assert parse_features(bytes.fromhex(text)) == frozenset()


@pytest.mark.parametrize("text", ["00", "01", "0002", "000282", "00028200ff"])
def test_settings_that_are_cut_short_are_left_out(text: str) -> None:
    assert parse_settings(bytes.fromhex(text)) == {}


def test_settings_of_other_sizes_are_read_and_an_unknown_one_ends_them() -> None:
    parameters = bytes.fromhex("0301e8030000 0401 04 0601" + "aa" * 16 + "09010203 00018200")
    assert parse_settings(parameters) == {
        Setting.RANGE_MILLIUNIT: (1000,),
        Setting.CHANNELS: (4,),
        Setting.SECURITY: (int.from_bytes(b"\xaa" * 16, "little"),),
    }


@pytest.mark.parametrize(("wanted", "rate"), [(50, 50), (60, 50), (199, 100), (500, 200), (10, 25)])
def test_the_wanted_rate_or_the_next_lower_one_is_chosen(wanted: int, rate: int) -> None:
    assert choose(ACC_OFFER, {Setting.SAMPLE_RATE: wanted, Setting.RANGE: 4}) == acc(rate, 4)


def test_nothing_is_chosen_of_what_a_start_cannot_say() -> None:
    offered = {Setting.FACTOR: (0.5,), Setting.CHANNELS: (), Setting.RESOLUTION: (14, 16)}
    assert choose(offered, {Setting.SAMPLE_RATE: 130}) == {Setting.RESOLUTION: 16}


@given(st.binary(max_size=512))
def test_any_bytes_are_understood_or_not(data: bytes) -> None:
    assert len(parse_features(data)) <= 16
    message = parse_indication(data)
    if isinstance(message, Reply):
        assert message.status_text
    settings = parse_settings(data)
    assert sum(len(values) for values in settings.values()) <= len(data)
    for measurement in Measurement:
        assert len(start(measurement, choose(settings, {Setting.SAMPLE_RATE: 50}))) <= 2 + 5 * 6
