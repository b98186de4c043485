"""The driver streams from virtual Movesense sensors, and finds them."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.movesense import SPEC
from biosensor_gateway.devices.movesense.driver import (
    DRIVER,
    MovesenseSettings,
    identify,
    recognise,
)
from biosensor_gateway.devices.movesense.driver.protocol import (
    COMMAND,
    parse_greeting,
    parse_message,
)
from biosensor_gateway.devices.movesense.simulator import Firmware, wire
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import What
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.gatt_host import GattHost, connection
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from tests.movesense.conftest import MakeSensor

# The driver streams from virtual Movesense sensors: all of it, once, at the right time.


@pytest.mark.parametrize(
    ("fields", "count"),
    [
        ({"ecg_rate_hz": 512, "imu_rate_hz": 208, "mag": True}, 500),
        ({"ecg_rate_hz": 125, "imu_rate_hz": 13, "gyro": False}, 30),
        ({"ecg_in_millivolts": True, "acc": False}, 100),
        ({"acc": False, "mag": True}, 100),
        ({"gyro": False, "mag": True}, 100),
    ],
    ids=["fastest", "slowest", "millivolts", "without acceleration", "without rotation"],
)
@ON_BUMBLE
async def test_rates_and_streams_are_those_of_the_settings(
    sensor: MakeSensor, fields: dict[str, bool | int], count: int
) -> None:
    movesense = sensor()
    wanted = [name for name in ("acc", "gyro", "mag") if fields.get(name, name != "mag")]
    async with streaming(movesense, **fields) as run:
        await until(run.sink.has(count, "ecg", *wanted))
        assert run.sink.rates["ecg"] == fields.get("ecg_rate_hz", 200)
        assert run.sink.rates["acc"] == fields.get("imu_rate_hz", 52)
    for name in ("ecg", *wanted):
        places = assert_once_and_in_order(run.sink.rows[name], movesense.truth.samples(name).values)
        assert places == list(range(len(places))), name
    for name in {"acc", "gyro", "mag"} - set(wanted):
        assert not run.sink.rows[name]
    assert run.sink.dropped_bytes == 0


@pytest.mark.parametrize("max_mtu", [23, 65, 161, 247])
@ON_BUMBLE
async def test_packets_of_any_number_of_parts_are_put_together(
    sensor: MakeSensor, max_mtu: int
) -> None:
    movesense = sensor(firmware=Firmware(max_mtu=max_mtu))
    async with streaming(movesense, mag=True, imu_rate_hz=104) as run:
        await until(run.sink.has(200, "acc", "ecg"))
        assert {run.sink.lost_count(stream.data_name) for stream in SPEC.streams} == {0}
    for name in ("ecg", "acc", "mag"):
        places = assert_once_and_in_order(run.sink.rows[name], movesense.truth.samples(name).values)
        assert places == list(range(len(places)))


async def test_it_is_known_by_what_it_says_of_itself(sensor: MakeSensor) -> None:
    async with connected(sensor()) as info:
        assert (info.info.model, info.info.serial_number) == ("Movesense HR2", "174630000192")
        assert info.info.firmware_version == "gatt_sensordata_app 1.2.0"
        assert info.silent == {"mag"}
        assert not info.denied


@ON_BUMBLE
async def test_firmware_that_answers_no_subscription_is_read_all_the_same(
    sensor: MakeSensor,
) -> None:
    movesense = sensor(firmware=Firmware(is_old=True))
    async with streaming(movesense) as run:
        await until(run.sink.has(2, "hr", "ibi", "temp"))
        await until(run.sink.has(100, "ecg", "acc"))
        assert run.states == [State.CONNECTING, State.STREAMING]
        assert run.sink.info.serial_number == ""


@ON_BUMBLE
async def test_a_path_that_is_refused_is_said_and_the_others_come(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("biosensor_gateway.devices.movesense.simulator.wire.ECG_RATES", (125,))
    movesense = sensor()
    async with streaming(movesense) as run:
        await until(run.sink.has(50, "acc", "gyro"))
    assert not run.sink.rows["ecg"]
    async with connected(movesense) as info:
        assert set(info.denied) == {"ecg"}
        assert "/Meas/ECG/200 is refused (404): choose another rate" in info.denied["ecg"]


_DENIED = (
    ("hr, ibi", "/Meas/HR"),
    ("temp", "/Meas/Temp"),
    ("ecg", "/Meas/ECG/200"),
    ("acc, gyro", "/Meas/IMU6/52"),
)


@pytest.mark.parametrize("is_old", [False, True])
@ON_BUMBLE
async def test_each_signal_that_is_refused_is_said_and_the_others_come(
    sensor: MakeSensor, is_old: bool
) -> None:
    movesense = sensor(firmware=Firmware(is_old=is_old))
    names = ("hr", "ibi", "temp", "ecg", "acc", "gyro")
    async with streaming(movesense) as run:
        await until(lambda: run.supervisor.connections == 1)
        for number, (streams, path) in enumerate(_DENIED, start=2):
            movesense.apply(Fault(FaultKind.DENY, 3600.0))
            await until(lambda number=number: run.supervisor.connections == number)
            await run.goes_on(2, *(each for each in names if each not in streams))
            assert run.supervisor.last_error == (
                f"connected, but the device refuses {streams} ({path} is refused (507): it has no "
                "room for more measurements; switch one off in the settings)"
            )
        movesense.clear(FaultKind.DENY)
        movesense.apply(Fault(FaultKind.DROP, 0.1))
        await run.goes_on(2, *names)
        assert run.supervisor.last_error is None


@ON_BUMBLE
async def test_nothing_is_said_of_contact_where_nobody_looks_for_beats(sensor: MakeSensor) -> None:
    movesense = sensor()
    movesense.apply(Fault(FaultKind.DENY, 3600.0))
    async with streaming(movesense) as run:
        await until(run.sink.has(8, "temp"))
        assert not run.sink.rows["quality"]


@ON_BUMBLE
async def test_who_refuses_everything_is_tried_again_and_says_so(sensor: MakeSensor) -> None:
    movesense = sensor()
    movesense.apply(Fault(FaultKind.REFUSE, 3600.0))
    with pytest.raises(ProtocolError) as caught:
        async with connected(movesense):
            pass
    assert caught.value.reason is ProtocolReason.REFUSED
    assert "refuses to communicate (403)" in str(caught.value)


@ON_BUMBLE
async def test_firmware_without_the_protocol_is_said(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    has = BleLink.has

    def without_commands(link: BleLink, uuid: str) -> bool:
        return uuid != COMMAND and has(link, uuid)

    monkeypatch.setattr(BleLink, "has", without_commands)
    with pytest.raises(ProtocolError, match=r"update its firmware to 2\.3") as caught:
        async with connected(sensor()):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@ON_BUMBLE
async def test_pairing_is_done_where_the_settings_ask(sensor: MakeSensor) -> None:
    movesense = sensor(firmware=Firmware(demands_pairing=True))
    async with streaming(movesense, pair=True) as run:
        await until(run.sink.has(50, "ecg"))


# Which advertisements are Movesense sensors, and how they come into the settings.
ADDRESS = "0C:8C:DC:10:F7:D3"
HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})


def seen(name: str) -> Advertisement:
    return Advertisement(ADDRESS, name, -60, HEART_RATE)


def test_a_sensor_is_found_with_the_settings_that_lead_to_it() -> None:
    found = recognised(drivers_by_precedence(), seen("Movesense 174630000192"))
    assert found is not None
    assert (found.sensor, found.name) == ("movesense", "Movesense 174630000192")
    settings = MovesenseSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("174630000192", ADDRESS)
    assert identify(seen("Movesense 174630000192")) == "174630000192"


@pytest.mark.parametrize("name", ["", "Movesensex 1", "Polar H10 A1B2C3D4", "My Movesense 1"])
def test_anything_else_is_none(name: str) -> None:
    assert recognise(seen(name)) is None


SERIAL = "174630000192"


def test_address_and_serial_number_are_replaced_and_the_rest_is_read_alike() -> None:
    data = wire.greeting(3, SERIAL, old=False)
    event = Event(t=0.0, link=0, what=What.CAME, data=data.hex())
    (told,) = Redaction(lambda _: False, DRIVER.identifiers).of([event], [SERIAL])
    assert b"0C8CDC000001" not in told.bytes
    assert SERIAL.encode() not in told.bytes
    message = parse_message(told.bytes)
    assert message is not None
    greeting = parse_greeting(message.payload)
    assert greeting.product == "Movesense HR2"
    assert len(greeting.serial_number) == len(SERIAL)


# The virtual sensor on the virtual radio, heard through plain bleak.


NAME = "Movesense 174630000192"
COMMAND_CHARACTERISTIC = "34800001-7185-4d5d-b431-630e7050e8f0"
DATA = "34800002-7185-4d5d-b431-630e7050e8f0"


async def tell(host: GattHost, *command: bytes) -> None:
    await host.client.write_gatt_char(COMMAND_CHARACTERISTIC, b"".join(command), response=True)


async def packets(host: GattHost, reference: int, count: int, *, part: int = 2) -> list[bytes]:
    """Wait for so many notifications of a subscription."""
    head = bytes([part, reference])

    def found() -> list[bytes]:
        return [each for each in host.all(DATA) if each.startswith(head)]

    await until(lambda: len(found()) >= count)
    return found()[:count]


@ON_BUMBLE
async def test_its_packets_are_as_long_as_those_of_a_real_one(sensor: MakeSensor) -> None:
    sensor()
    async with connection(NAME) as host:
        await host.subscribe(DATA)
        await tell(host, b"\x01\x64/Meas/ECG/200")
        await tell(host, b"\x01\x65/Meas/IMU9/52\0")
        await tell(host, b"\x01\x66/Meas/HR")
        await tell(host, b"\x01\x67/Meas/Temp")
        lengths = [len((await packets(host, ref, 2))[1]) - 2 for ref in (100, 101, 102, 103)]
        assert lengths == [68, 148, 6, 8]
        answers = [each for each in host.all(DATA) if each[0] == 1]
        assert answers == [bytes([1, ref]) + struct.pack("<H", 200) for ref in range(100, 104)]
