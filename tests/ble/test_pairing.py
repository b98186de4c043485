"""When a device is paired and when it is forgotten: Windows' part of it without Windows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from bleak import BleakClient
from bleak.exc import BleakError
from pydantic import TypeAdapter, ValidationError

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import (
    EARLY_DROP_S,
    AttError,
    Pairing,
    PairMode,
    PairSetting,
)
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.polling import until
from tests.rigs.probe import SECRET, Probe

SILENT = TransportError(TransportReason.SILENT, "no answer")
LOST = TransportError(TransportReason.LOST, "cut")
ADDRESS = "A0:9E:1A:00:00:01"
PLATFORMS = ("win32", "linux", "darwin")


@pytest.mark.parametrize(
    ("value", "mode"),
    [("auto", "auto"), ("yes", "yes"), ("no", "no"), (True, "yes"), (False, "auto")],
)
def test_the_setting_is_a_mode_or_a_switch(value: object, mode: PairMode) -> None:
    assert TypeAdapter[PairMode](PairSetting).validate_python(value) == mode


@pytest.mark.parametrize("value", ["", "true", 1, None])
def test_nothing_else_is_one(value: object) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter[PairMode](PairSetting).validate_python(value)


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize(
    ("error", "is_unanswered", "helps"),
    [
        (AttError(0x05, "strap"), True, True),
        (AttError(0x05, "strap"), False, True),
        (AttError(0x0F, "strap"), True, True),
        (AttError(0x0E, "strap"), True, True),
        (AttError(0x0E, "strap"), False, False),
        (AttError(0x80, "strap"), True, False),
        (SILENT, True, True),
        (SILENT, False, False),
        (LOST, True, False),
    ],
)
def test_what_pairing_helps_against(
    platform: str, error: GatewayError, *, is_unanswered: bool, helps: bool
) -> None:
    assert Pairing("auto", platform).helps(error, is_unanswered=is_unanswered) is helps
    assert not Pairing("no", platform).helps(error, is_unanswered=is_unanswered)


@pytest.mark.parametrize("platform", PLATFORMS)
def test_who_wants_it_pairs_before_each_connection(platform: str) -> None:
    assert Pairing("yes", platform).comes_first
    assert not Pairing("auto", platform).comes_first
    assert not Pairing("no", platform).comes_first


def test_windows_pairs_first_once_the_device_has_demanded_it() -> None:
    windows, linux = Pairing(platform="win32"), Pairing(platform="linux")
    windows.note_demand()
    linux.note_demand()
    assert (windows.comes_first, linux.comes_first) == (True, False)


@pytest.mark.parametrize("after_s", [0.0, 0.2, EARLY_DROP_S - 0.01])
def test_windows_pairs_first_after_an_early_drop(after_s: float) -> None:
    pairing = Pairing(platform="win32")
    pairing.note_drop(after_s)
    assert pairing.comes_first


@pytest.mark.parametrize(
    ("mode", "platform", "after_s"),
    [("auto", "win32", EARLY_DROP_S), ("no", "win32", 0.0), ("auto", "linux", 0.0)],
)
def test_no_other_drop_means_anything(mode: PairMode, platform: str, after_s: float) -> None:
    pairing = Pairing(mode, platform)
    pairing.note_drop(after_s)
    assert not pairing.comes_first


def test_paired_and_unpaired_are_tried_in_turns_while_neither_works() -> None:
    pairing = Pairing(platform="win32")
    tried: list[bool] = []
    for _ in range(4):
        tried.append(pairing.comes_first)
        pairing.note_drop(0.0)
    assert tried == [False, True, False, True]


def test_what_is_paired_stays_so_through_a_drop() -> None:
    pairing = Pairing(platform="win32")
    pairing.note_drop(0.0)
    pairing.note_paired()
    for after_s in (0.1, 600.0):
        pairing.note_drop(after_s)
        assert pairing.comes_first


@pytest.mark.parametrize("platform", PLATFORMS)
def test_only_windows_forgets_it_at_the_end_and_only_what_it_did_for_us(platform: str) -> None:
    pairing = Pairing(platform=platform)
    assert not pairing.ends_with_connection
    pairing.note_paired()
    assert pairing.ends_with_connection is (platform == "win32")
    pairing.note_unpaired()
    assert not pairing.ends_with_connection
    assert pairing.uses_known_services is (platform != "win32")


class Calls:
    """Notes what is asked of bleak, in order; the virtual system does it all the same."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.made: list[str] = []
        self.options: list[dict[str, Any]] = []
        for name in ("pair", "unpair", "disconnect"):
            monkeypatch.setattr(BleakClient, name, self._noting(name, getattr(BleakClient, name)))
        original = BleakClient.__init__

        def make(client: BleakClient, *args: Any, **options: Any) -> None:
            self.options.append(options)
            original(client, *args, **options)

        monkeypatch.setattr(BleakClient, "__init__", make)

    def _noting(self, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        async def call(client: BleakClient) -> None:
            self.made.append(name)
            await original(client)

        return call


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    return Calls(monkeypatch)


@pytest.fixture
def probe(radio: Radio) -> Probe:
    probe = Probe(radio, ADDRESS, "Probe 1")
    probe.peripheral.demand_pairing = True
    probe.power_on()
    return probe


def link_of(pairing: Pairing) -> BleLink:
    return BleLink(Choice(lambda seen: seen.address, "probe", ADDRESS), pairing=pairing)


@ON_BUMBLE
async def test_on_windows_the_pairing_ends_before_the_connection(
    probe: Probe, calls: Calls
) -> None:
    link = link_of(Pairing(platform="win32"))
    await link.open()
    await link.pair()
    assert await link.read(SECRET) == b"secret"
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert calls.made == ["pair", "unpair", "disconnect"]
    assert calls.options[0]["winrt"] == {"use_cached_services": False}


@ON_BUMBLE
async def test_elsewhere_it_stays(probe: Probe, calls: Calls) -> None:
    link = link_of(Pairing(platform="linux"))
    await link.open()
    await link.pair()
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert calls.made == ["pair", "disconnect"]
    assert calls.options[0]["winrt"] == {}


@ON_BUMBLE
async def test_a_link_that_drops_at_once_is_paired_before_the_next_one(
    probe: Probe, calls: Calls
) -> None:
    pairing = Pairing(platform="win32")
    link = link_of(pairing)
    await link.open()
    probe.drop()
    with pytest.raises(TransportError):
        await link.next()
    await link.close()
    assert calls.options[0]["pair"] is False
    probe.restore()
    again = link_of(pairing)
    await again.open()
    assert await again.read(SECRET) == b"secret"
    await again.close()
    assert calls.options[-1]["pair"] is True
    assert calls.made[-2:] == ["unpair", "disconnect"]


@ON_BUMBLE
async def test_who_cannot_unpair_disconnects_all_the_same(
    probe: Probe, calls: Calls, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(_: BleakClient) -> None:
        raise BleakError("Failed to unpair device")

    monkeypatch.setattr(BleakClient, "unpair", fails)
    link = link_of(Pairing(platform="win32"))
    await link.open()
    await link.pair()
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert calls.made == ["pair", "disconnect"]
