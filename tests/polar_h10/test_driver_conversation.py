"""What the driver asks of a Polar sensor, what it makes of the answers, and pairing."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import pytest

from biosensor_common.errors import CredentialError, ProtocolError, ProtocolReason
from biosensor_gateway.devices.polar_h10.driver import control as control_module
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports.ble import BleLink
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polar_h10 import assert_only_gaps
from tests.rigs.polling import until

MakeSensor = Callable[..., SimulatedPolarH10]


@contextmanager
def noted_writes(monkeypatch: pytest.MonkeyPatch) -> Generator[list[str]]:
    """Note what the host asks, in order."""
    asked: list[str] = []
    originals = {name: getattr(BleLink, name) for name in ("read", "write", "subscribe")}

    def noting(name: str) -> Callable[..., Any]:
        async def ask(link: BleLink, uuid: str, *arguments: Any, **options: Any) -> Any:
            data = arguments[0].hex() if arguments else ""
            asked.append(f"{name} {uuid[4:8]} {data}".strip())
            return await originals[name](link, uuid, *arguments, **options)

        return ask

    with monkeypatch.context() as patch:
        for name in originals:
            patch.setattr(BleLink, name, noting(name))
        yield asked


async def test_the_control_point_is_spoken_to_in_the_vendor_s_order(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor()
    with noted_writes(monkeypatch) as asked:
        async with connected(h10, acc_rate_hz=100, acc_range_g=4):
            pass
    about_pmd = [each for each in asked if " 5c8" in each]
    assert about_pmd == [
        "read 5c81",
        "subscribe 5c81",
        "subscribe 5c82",
        "write 5c81 0100",
        "write 5c81 02000001820001010e00",
        "write 5c81 0102",
        "write 5c81 0202000164000101100002010400",
        "write 5c81 0300",
        "write 5c81 0302",
    ]


async def test_a_former_host_s_measurements_are_stopped_first(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    quirks = Quirks(left_streaming=(Measurement.ECG, Measurement.ACC), short_errors=True)
    h10 = sensor(quirks)
    with noted_writes(monkeypatch) as asked:
        async with streaming(h10) as run:
            await until(run.sink.has(73, "ecg"))
            await until(run.sink.has(36, "acc"))
    starts = [each for each in asked if each.startswith(("write 5c81 0200", "write 5c81 0300"))]
    assert [each[11:15] for each in starts[:3]] == ["0200", "0300", "0200"]
    assert_only_gaps(h10, run.sink)


async def test_the_device_is_left_still(sensor: MakeSensor) -> None:
    """One that is left measuring empties its battery."""
    h10 = sensor(Quirks(keeps_streaming=True))
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
    sent = len(h10.truth.samples("ecg").times)
    async with connected(h10, ecg=False, acc=False):
        # Longer than a frame.
        await asyncio.sleep(0.8)
        assert len(h10.truth.samples("ecg").times) == sent


async def test_a_device_that_never_answers_is_an_error(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert control_module.REPLY_TIMEOUT_S == 5.0
    monkeypatch.setattr(control_module, "REPLY_TIMEOUT_S", 0.3)
    h10 = sensor()
    h10.apply(Fault(FaultKind.LATE, 30.0))
    with pytest.raises(ProtocolError) as caught:
        async with connected(h10):
            pass
    assert caught.value.reason is ProtocolReason.NO_REPLY


async def test_a_device_that_demands_pairing_is_paired(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor(Quirks(demands_pairing=True))
    paired: list[str] = []
    original = BleLink.pair

    async def pair(link: BleLink) -> None:
        paired.append(link.what)
        await original(link)

    monkeypatch.setattr(BleLink, "pair", pair)
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        assert run.supervisor.connections == 1
        assert run.supervisor.last_error is None
        assert len(paired) == 1
        # The bond holds.
        h10.apply(Fault(FaultKind.DROP, 0.5))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on(73, "ecg")
        assert len(paired) <= 2
    assert_only_gaps(h10, run.sink)


async def test_pairing_may_come_first(sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch) -> None:
    h10 = sensor(Quirks(demands_pairing=True))

    async def pair(link: BleLink) -> None:
        raise AssertionError(f"{link.what} is paired already")

    monkeypatch.setattr(BleLink, "pair", pair)
    async with connected(h10, pair=True) as info:
        assert info.rates["ecg"] == 130


async def test_a_device_that_cannot_be_paired_is_a_matter_of_credentials(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor(Quirks(demands_pairing=True))

    async def pair(link: BleLink) -> None:
        """Do as a system does that believes it is paired already."""

    monkeypatch.setattr(BleLink, "pair", pair)
    with pytest.raises(CredentialError, match="remove the sensor in the system's Bluetooth"):
        async with connected(h10):
            pass
