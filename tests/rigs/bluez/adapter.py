"""The adapter and the service itself, org.bluez.Adapter1, and the programs on the bus."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import ExitStack
from functools import cached_property
from typing import Any, Protocol, Self, cast

from dbus_fast.aio import MessageBus
from dbus_fast.message import Message
from dbus_fast.signature import Variant

from biosensor_gateway.demo.virtual_devices import Scene
from biosensor_gateway.simulation.central import Central, Heard
from biosensor_gateway.simulation.radio import Radio
from tests.rigs.bluez.device import FakeDevice
from tests.rigs.bluez.objects import BluezError, ObjectTree, Properties, Reply, failed, not_ready
from tests.rigs.bluez.private_bus import PrivateBus

# The adapter and the service itself: org.bluez.Adapter1.

_NAME = "org.bluez"
_ADAPTER = "org.bluez.Adapter1"
_PATH = "/org/bluez/hci0"


class FakeBluez:
    """BlueZ with one adapter on a virtual radio; a context manager.

    Its public methods are for every thread but the world's.

    Parameters
    ----------
    radio
        The air; its ``available`` is the adapter's switch, see `set_powered`.
    """

    tree: ObjectTree
    central: Central

    def __init__(self, radio: Radio) -> None:
        self._radio = radio
        self._private_bus = PrivateBus()
        self._bus: MessageBus | None = None
        self._devices: dict[str, FakeDevice] = {}
        self._scanning: dict[str | None, bool] = {}
        self._duplicates: dict[str | None, bool] = {}
        self._stack = ExitStack()
        self.environment = self._private_bus.environment  # For the process in which bleak runs.
        self.connect_delay_s = 0.0  # How much longer than needed it takes to connect.
        self.connect_error = ""  # Why connecting fails, in BlueZ's words; empty if it does not.
        # Whether devices that are not connected are forgotten when a scan ends, not half a minute
        # later.
        self.forgets_after_scan = False
        # Whether requests that need pairing are answered with "Not paired", not with an unlikely
        # error.
        self.words_security = False
        # By method, such as `StartDiscovery`, for how many seconds the answer to the next call of
        # it is kept back.
        self.late: dict[str, float] = {}

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._private_bus)
            self._radio.world.await_(self._start())
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._radio.world.await_(self._stop())
        self._stack.close()

    @property
    def powered(self) -> bool:
        """Whether the adapter is switched on."""
        return self._radio.available

    @property
    def scanning(self) -> bool:
        """Whether a program has begun a scan and not ended it."""
        return bool(self._scanning)

    @property
    def connected(self) -> bool:
        """Whether any device is connected, or is being connected."""
        return any(each.connected for each in self._devices.values())

    def set_powered(self, powered: bool) -> None:
        """Switch the adapter; off, links are lost and scans end."""
        self._radio.available = powered
        self._radio.world.call(self._tell_powered)

    def forget(self, address: str) -> None:
        """Remove a device's object, as BlueZ does some time after a scan."""
        self._radio.world.call(lambda: self._devices.pop(address).forget())

    def die(self) -> None:
        """Vanish from the bus without a word, as a daemon that is killed; its links are lost."""
        self._radio.world.await_(self._stop())

    def rise(self) -> None:
        """Start again after `die`, and know no device any more."""
        self._radio.world.await_(self._start())

    def kill_bus(self) -> None:
        """End the bus itself."""
        self._private_bus.kill()

    async def _start(self) -> None:
        self.central = await Central.on_the_air(self._radio)
        self._radio.on_switched_off.append(self._on_switched_off)
        self._bus = await MessageBus(bus_address=self._private_bus.address).connect()
        self.tree = ObjectTree(self._bus, self.late)
        await watch_clients(self._bus, self._end_client)
        methods = {
            "SetDiscoveryFilter": self._set_filter,
            "StartDiscovery": self._start_discovery,
            "StopDiscovery": self._stop_discovery,
            "RemoveDevice": self._remove_device,
        }
        self.tree.add(_PATH, _ADAPTER, self._properties(), methods)
        await self._bus.request_name(_NAME)

    async def _stop(self) -> None:
        bus, self._bus = self._bus, None
        if bus is None:
            return
        self._radio.on_switched_off.remove(self._on_switched_off)
        if bus.connected:
            bus.disconnect()
            await bus.wait_for_disconnect()
        await self.central.close()
        self._devices.clear()
        self._scanning.clear()
        self._duplicates.clear()

    def _properties(self) -> Properties:
        return {
            "Address": Variant("s", "F0:00:00:00:00:01"),
            "AddressType": Variant("s", "public"),
            "Name": Variant("s", "virtual"),
            "Alias": Variant("s", "virtual"),
            "Class": Variant("u", 0),
            "Powered": Variant("b", self.powered),
            "Discoverable": Variant("b", False),
            "Pairable": Variant("b", True),
            "Discovering": Variant("b", False),
            "UUIDs": Variant("as", []),
            "Roles": Variant("as", ["central", "peripheral"]),
        }

    async def _set_filter(self, call: Message) -> Reply:
        (wanted,) = call.body
        duplicates = wanted.get("DuplicateData")
        self._duplicates[call.sender] = bool(duplicates and duplicates.value)
        return None

    async def _start_discovery(self, call: Message) -> Reply:
        if not self.powered:
            raise not_ready()
        if call.sender in self._scanning:
            raise BluezError("org.bluez.Error.InProgress", "Operation already in progress")
        if not self._scanning:
            await self.central.listen(self._on_heard)
        self._scanning[call.sender] = self._duplicates.get(call.sender, False)
        self._tell_discovering()
        return None

    async def _stop_discovery(self, call: Message) -> Reply:
        if not self.powered:
            raise not_ready()
        if call.sender not in self._scanning:
            raise failed("No discovery started")
        del self._scanning[call.sender]
        if not self._scanning:
            await self.central.unlisten(self._on_heard)
            self._end_of_scan()
        return None

    async def _remove_device(self, call: Message) -> Reply:
        (path,) = call.body
        for address, device in list(self._devices.items()):
            if device.path == path:
                await device.unpair()
                del self._devices[address]
                device.forget()
                return None
        raise BluezError("org.bluez.Error.DoesNotExist", "Does Not Exist")

    async def _end_client(self, name: str) -> None:
        for device in list(self._devices.values()):
            await device.end_client(name)

    def _on_heard(self, heard: Heard) -> None:
        device = self._devices.get(heard.address)
        if device is None:
            device = self._devices[heard.address] = FakeDevice(self, _PATH, heard.address)
        device.hear(heard, duplicates=any(self._scanning.values()))

    def _end_of_scan(self) -> None:
        for address, device in list(self._devices.items()):
            device.unheard()
            if self.forgets_after_scan and not device.connected:
                del self._devices[address]
                device.forget()
        self._tell_discovering()

    def _on_switched_off(self) -> None:
        self._scanning.clear()
        self._end_of_scan()
        self._tell_powered()

    def _tell_powered(self) -> None:
        self.tree.change(_PATH, _ADAPTER, {"Powered": Variant("b", self.powered)})

    def _tell_discovering(self) -> None:
        discovering = Variant("b", bool(self._scanning))
        self.tree.change(_PATH, _ADAPTER, {"Discovering": discovering})


# The programs on a bus, and when they leave it.
_DAEMON = "org.freedesktop.DBus"
_MEMBER = "NameOwnerChanged"


class _Bus(Protocol):
    """What is used of the bus, whose annotation leaves a type argument out."""

    def call(self, msg: Message) -> Awaitable[object]: ...


async def watch_clients(
    bus: MessageBus, on_left: Callable[[str], Coroutine[Any, Any, None]]
) -> None:
    """Call back with the unique name of each program that leaves, killed or not."""
    running: set[asyncio.Task[None]] = set()

    def on_message(message: Message) -> None:
        if message.member == _MEMBER and message.interface == _DAEMON:
            name, _, owner = message.body
            if not owner:
                task = asyncio.ensure_future(on_left(name))
                running.add(task)
                task.add_done_callback(running.discard)

    bus.add_message_handler(on_message)
    rule = f"type='signal',interface='{_DAEMON}',member='{_MEMBER}'"
    await cast("_Bus", bus).call(
        Message(
            destination=_DAEMON,
            path="/org/freedesktop/DBus",
            interface=_DAEMON,
            member="AddMatch",
            signature="s",
            body=[rule],
        )
    )


class BluezScene(Scene):
    """A scene whose air is heard by a fake BlueZ, which there is from the first use on."""

    def __init__(self, stack: ExitStack) -> None:
        super().__init__(stack)
        self._bluez_stack = stack
        self.bluez: FakeBluez | None = None

    @cached_property
    def radio(self) -> Radio:
        """The air."""
        radio = Radio(self.world)
        self.bluez = self._bluez_stack.enter_context(FakeBluez(radio))
        return radio
