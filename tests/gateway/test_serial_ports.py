"""The serial ports and UDP ports of a computer."""

from __future__ import annotations

import errno
import shutil
import socket
from collections.abc import AsyncGenerator
from typing import Any, NamedTuple

import pytest
from dbus_fast import BusType
from dbus_fast.aio import MessageBus
from dbus_fast.signature import Variant
from serial.tools import list_ports

from biosensor_gateway.devices.registry import driver
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports import serial_port as ports
from biosensor_gateway.transports.link import Address
from biosensor_gateway.transports.nearby import SerialPort
from biosensor_gateway.transports.ports import UdpPort
from tests.rigs.bluez.objects import ObjectTree
from tests.rigs.bluez.private_bus import PrivateBus
from tests.rigs.memory_links import MemoryUdpPort
from tests.rigs.polling import until

# The serial ports of a computer: how Windows and BlueZ tell whose they are.

SERVICE = ports.SERIAL_PORT_SERVICE
SHIMMER, BIOHARNESS = "00:06:66:AA:BB:CC", "00:07:80:5A:3E:7E"


class Comport(NamedTuple):
    """What pyserial tells of a port."""

    device: str
    hwid: str
    description: str = "Serielle Standardverbindung"


def outgoing(address: str, suffix: str = "_C00000000") -> str:
    return f"BTHENUM\\{{{SERVICE.upper()}}}_LOCALMFG&0000\\7&23456789&0&{address}{suffix}"


async def windows(monkeypatch: pytest.MonkeyPatch, *comports: Comport) -> list[SerialPort]:
    monkeypatch.setattr(ports.sys, "platform", "win32")
    monkeypatch.setattr(list_ports, "comports", lambda: comports)
    monkeypatch.setattr(ports, "_windows_name", {"000666AABBCC": "Shimmer3-BBCC"}.get)
    return await ports.serial_ports()


async def test_windows_tells_the_address_behind_an_outgoing_port(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (port,) = await windows(monkeypatch, Comport("COM7", outgoing("000666AABBCC")))
    assert port == SerialPort("COM7", "Shimmer3-BBCC", SHIMMER)
    recognise = driver("shimmer3_gsr").recognise
    assert recognise is not None
    found = recognise(port)
    assert found is not None
    assert found.settings == {"unit": "BBCC", "port": "COM7"}


@pytest.mark.parametrize("suffix", ["_C00000000", "_C0000000A", "_c00000003"])
async def test_the_address_is_read_in_either_case(
    monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    (port,) = await windows(monkeypatch, Comport("COM7", outgoing("000666aabbcc", suffix)))
    assert port.remote_address == SHIMMER


async def test_windows_lists_no_port_that_waits_for_a_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = await windows(
        monkeypatch,
        Comport("COM3", outgoing("000000000000", "_00000000")),
        Comport("COM4", outgoing("000000000000")),
        Comport("COM5", outgoing("000666AABBCC")),
    )
    assert [port.port for port in found if port.remote_address] == ["COM5"]
    assert "COM4" not in {port.port for port in found}
    assert "COM3" not in {port.port for port in found}


@pytest.mark.parametrize(
    "hwid",
    ["", "n/a", "USB VID:PID=0403:6001 SER=A50285BIA", "ACPI\\PNP0501\\0", "BTHENUM\\{nonsense}"],
)
async def test_other_ports_have_no_address(monkeypatch: pytest.MonkeyPatch, hwid: str) -> None:
    assert await windows(monkeypatch, Comport("COM1", hwid)) == [SerialPort("COM1")]


def device(address: str, name: str | None, *, paired: bool = True, uuid: str = SERVICE) -> Any:
    named = {} if name is None else {"Name": Variant("s", name)}
    return {
        "Address": Variant("s", address),
        "Paired": Variant("b", paired),
        "UUIDs": Variant("as", ["0000110a-0000-1000-8000-00805f9b34fb", uuid]),
        **named,
    }


@pytest.fixture
async def bluez(monkeypatch: pytest.MonkeyPatch) -> AsyncGenerator[ObjectTree]:
    """A BlueZ with nothing but the objects that a test adds."""
    if not shutil.which("dbus-daemon"):
        pytest.skip("dbus-daemon is needed")
    with PrivateBus() as bus:
        for variable, text in bus.environment.items():
            monkeypatch.setenv(variable, text)
        connection = await MessageBus(bus_type=BusType.SYSTEM).connect()
        await connection.request_name("org.bluez")
        yield ObjectTree(connection)
        connection.disconnect()
        await connection.wait_for_disconnect()


def addresses(found: list[SerialPort]) -> dict[str, SerialPort]:
    return {port.remote_address: port for port in found if port.remote_address}


@pytest.mark.nightly
async def test_bluez_tells_the_paired_devices_with_a_serial_service(bluez: ObjectTree) -> None:
    known = (
        device(SHIMMER, "Shimmer3-BBCC"),
        device(BIOHARNESS, "BH BHT012345"),
        device("00:00:00:00:00:01", "unpaired", paired=False),
        device("00:00:00:00:00:02", "headphones", uuid="0000110b-0000-1000-8000-00805f9b34fb"),
        device("00:00:00:00:00:03", None),
    )
    for number, properties in enumerate(known):
        bluez.add(f"/org/bluez/hci0/dev_{number}", "org.bluez.Device1", properties, {})
    bluez.add("/org/bluez/hci0", "org.bluez.Adapter1", {"Address": Variant("s", "x")}, {})
    assert addresses(await ports.serial_ports()) == {
        SHIMMER: SerialPort(SHIMMER, "Shimmer3-BBCC", SHIMMER),
        BIOHARNESS: SerialPort(BIOHARNESS, "BH BHT012345", BIOHARNESS),
    }


@pytest.mark.nightly
async def test_a_bluez_without_devices_has_no_ports(bluez: ObjectTree) -> None:
    assert addresses(await ports.serial_ports()) == {}


@pytest.mark.parametrize("address", ["nonsense", "unix:path=nowhere", "tcp:host=127.0.0.1,port=1"])
async def test_without_a_bus_the_ports_are_listed_without_names(
    monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", address)
    monkeypatch.setattr(ports, "_device_files", lambda: ["ttyUSB7"])
    assert await ports.serial_ports() == [SerialPort("ttyUSB7")]


@pytest.mark.nightly
async def test_on_a_bus_without_bluez_there_are_no_names(monkeypatch: pytest.MonkeyPatch) -> None:
    if not shutil.which("dbus-daemon"):
        pytest.skip("dbus-daemon is needed")
    with PrivateBus() as bus:
        monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", bus.address)
        assert addresses(await ports.serial_ports()) == {}


# A UDP port that a thread reads, and the one in memory that unit tests have in its place.
LOCAL = "127.0.0.1"
DEADLINE_S = 30.0
Datagram = tuple[bytes, float, Address]


@pytest.fixture
def received() -> list[Datagram]:
    return []


@pytest.fixture(params=["in memory", pytest.param("real", marks=pytest.mark.seam)])
async def port(request: pytest.FixtureRequest, received: list[Datagram]) -> AsyncGenerator[UdpPort]:
    made = MemoryUdpPort(LOCAL) if request.param == "in memory" else UdpPort(LOCAL)

    def take(data: bytes, arrival_s: float, sender: Address) -> None:
        received.append((data, arrival_s, sender))

    def lost(error: OSError) -> None:
        raise error

    made.listen(take, lost)
    yield made
    number = made.number
    await made.close()
    # It is free again at once.
    UdpPort(LOCAL, number).end()


async def test_datagrams_come_whole_with_their_time_and_sender(
    port: UdpPort, received: list[Datagram]
) -> None:
    begun_s = LSL_CLOCK()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (b"one", b"", b"three" * 1000):
            sender.sendto(data, (LOCAL, port.number))
        await until(lambda: len(received) == 3)
        address = sender.getsockname()[1]
    assert [data for data, _, _ in received] == [b"one", b"", b"three" * 1000]
    times_s = [begun_s, *(arrival_s for _, arrival_s, _ in received), LSL_CLOCK()]
    assert times_s == sorted(times_s)
    assert {sender for _, _, sender in received} == {(LOCAL, address)}


async def test_answers_go_where_they_are_sent_and_to_nobody_do_no_harm(
    port: UdpPort, received: list[Datagram]
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.bind((LOCAL, 0))
        asker.settimeout(DEADLINE_S)
        port.send(b"answer", asker.getsockname())
        assert asker.recvfrom(100) == (b"answer", (LOCAL, port.number))
        gone = asker.getsockname()
    for _ in range(3):
        port.send(b"nobody listens", gone)
    port.send(b"to itself", (LOCAL, port.number))
    await until(lambda: bool(received))
    assert received[0][0] == b"to itself"


async def test_a_port_that_another_program_has_is_refused(port: UdpPort) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        UdpPort(LOCAL, port.number)
    assert caught.value.errno == errno.EADDRINUSE
