"""What holds for any driver, tried with the virtual device of its sensor."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_common.quantities import ChannelRole
from biosensor_common.refusal import Refusal
from biosensor_gateway.agent import supervisor
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.registry import declaration, driver
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.truth import Contact, Gap
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.streaming.silence import PATIENCE_S
from biosensor_gateway.transports import ble_choice, ble_scanner
from biosensor_gateway.transports.nearby import SerialPort
from tests.contracts.conftest import ON_AIR, class_of, every, is_outside_time
from tests.rigs.driver_run import NotedSink, Run, connected, driver_maker, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from tests.contracts.conftest import Make

VALUES = {FaultKind.LOW_BATTERY: 4.0, FaultKind.GARBAGE: 20.0, FaultKind.DRIFT: 150.0}
SHORT_S = 0.5
SILENT_S = 3.0
TOO_LATE_S = 12.0
"""Later than anybody waits for an answer."""
MESSAGE_S = 1.0
"""What comes most rarely of all that has to come."""
ESTIMATED_S = 40.0
LONG_S = 3600.0
COUNT = 5
LOW_PERCENT = 10.0
LOSES = {FaultKind.DROP, FaultKind.RESTART, FaultKind.STALL}
BREAKS = {FaultKind.DROP, FaultKind.REFUSE, FaultKind.RESTART}
STREAMS = [State.CONNECTING, State.STREAMING]
CANNOT_BE = (FaultKind.REPEAT, FaultKind.STEP_BACK)
"""What is made up is the device's own doing."""
MOST_DENIED = 12
REFUSES = ("connected, but the device refuses", "refuses the request")
HARMLESS = VALUES.keys() | {FaultKind.OFF_BODY}


def measured(device: VirtualDevice) -> list[str]:
    """Return the streams of values that the wire has from the beginning, the regular ones first."""
    found = type(device)
    streams = [
        each
        for each in declaration(device.sensor).streams
        if not (each.is_state or each.message_type.is_text)
        and each.data_name not in found.filled
        and each.data_name not in found.expected.by_agent
    ]
    streams.sort(key=lambda each: not each.is_regular)
    return [each.data_name for each in streams]


@asynccontextmanager
async def told_the_truth(device: VirtualDevice) -> AsyncGenerator[Run]:
    """Stream; all values are to be measured ones, each once and in order, and so their times."""
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        yield run
    # A recording knows no truth, and its clock begins again with it.
    for name in measured(device) if device.truth.data_names else ():
        assert np.all(np.diff(run.sink.times[name]) > 0), name
        places(device, run, name)


def places(device: VirtualDevice, run: Run, data_name: str) -> list[int]:
    """Assert that values are measured ones, each once and in order; return which they are."""
    if not run.sink.rows[data_name]:
        return []
    # What has no value at all needs no place in the stream.
    values = device.truth.samples(data_name).values
    received = [row for row in run.sink.rows[data_name] if not np.isnan(row).all()]
    return assert_once_and_in_order(received, values[~np.isnan(values).all(axis=1)])


def is_regular(device: VirtualDevice, data_name: str) -> bool:
    """Tell whether the samples of a stream come at a rate."""
    return declaration(device.sensor).stream(data_name).is_regular


def imbalance(device: VirtualDevice, run: Run, kind: FaultKind) -> str:
    """Return which regular stream lost something else than is counted; empty if none did."""
    for name in filter(partial(is_regular, device), measured(device)):
        truth = device.truth.samples(name)
        has_value = ~np.isnan(truth.values).all(axis=1)
        found = np.array(places(device, run, name), np.int64)
        if len(found) < COUNT:
            continue
        times_s = truth.times[has_value][found]
        period_s = np.median(np.diff(truth.times))
        unread = int(found[-1] - found[0] + 1 - len(found))
        missing = int(np.maximum(0, np.round(np.diff(times_s) / period_s) - 1).sum())
        least, most = {
            Gap.MEASURED: (missing, missing),
            Gap.STOPPED: (unread, unread),
            Gap.UNKNOWN: (max(1, unread), missing),
        }[device.expected.gaps.get(kind, Gap.MEASURED)]
        allowed = device.expected.loss_tolerance.of(
            name,
            is_break=kind is not FaultKind.STALL,
            is_restart=kind is FaultKind.RESTART,
        )
        lost = run.sink.lost_count(name)
        if not least - allowed <= lost <= most + allowed:
            return f"{name}: {lost} counted, {least} to {most} lost"
    return ""


async def assert_counted(device: VirtualDevice, run: Run, kind: FaultKind) -> None:
    """Assert that what a fault cost is counted as lost, by those that estimate it later."""
    for _ in range(round(ESTIMATED_S)):
        if not imbalance(device, run, kind):
            break
        await asyncio.sleep(1.0)
    assert not imbalance(device, run, kind)


def is_silent(run: Run, data_name: str) -> bool:
    """Tell whether nothing received for long; a connection to a service may outlast it."""
    return run.sink.clock() - run.sink.times[data_name][-1] > SILENT_S


async def test_all_that_the_device_measures_arrives(device: VirtualDevice) -> None:
    names = measured(device)
    async with told_the_truth(device) as run:
        await until(run.sink.has(COUNT, *(each for each in names if is_regular(device, each))))
        await until(run.sink.has(1, *(each for each in names if each in device.truth.data_names)))
        assert run.supervisor.connections == 1
        assert run.states == STREAMS
        assert not run.error
        assert {name: run.sink.lost_count(name) for name in names} == dict.fromkeys(names, 0)
        assert run.sink.dropped_bytes == 0
    for name in names if device.truth.data_names else ():
        assert set(np.diff(places(device, run, name))) <= {1}, name


@ON_AIR
async def test_the_signal_strength_is_that_of_what_was_heard(make: Make) -> None:
    with make(rssi_dbm=-49) as device:
        async with streaming(device) as run:
            await until(run.sink.has(1, *measured(device)[:1]))
            await until(lambda: run.sink.rows["rssi"])
            assert run.sink.rows["rssi"][0] == [-49]


# What is denied does not come until the next connection: that is asked of `DENY` alone.
@every(*(kind for kind in FaultKind if kind not in CANNOT_BE and kind is not FaultKind.DENY))
async def test_it_goes_on_after_a_fault_and_makes_nothing_up(
    device: VirtualDevice, kind: FaultKind
) -> None:
    name = measured(device)[0]
    async with told_the_truth(device) as run:
        sent = [each for each in measured(device) if run.sink.rows[each]]
        device.apply(Fault(kind, VALUES.get(kind, LONG_S if kind in BREAKS else SHORT_S)))
        if kind in BREAKS:
            await until(lambda: run.states != STREAMS or is_silent(run, name))
            await asyncio.sleep(SHORT_S)
            device.clear(kind)
        elif kind is FaultKind.LATE:
            await until(lambda: run.supervisor.connections == 2)
        elif kind is FaultKind.GARBAGE:
            await until(lambda: run.sink.dropped_bytes > 0)
        await run.goes_on(COUNT, name)
        device.clear(kind)
        await run.goes_on(COUNT, *(each for each in sent if is_regular(device, each)), name)
        if kind in HARMLESS:
            assert run.supervisor.connections == 1
        elif kind in BREAKS and device.on_air and device.expected.is_linked:
            assert run.supervisor.connections == 2
        if kind in LOSES and device.truth.data_names:
            await assert_counted(device, run, kind)
        if kind is FaultKind.GARBAGE:
            assert {run.sink.lost_count(each) for each in measured(device)} == {0}
    if kind is FaultKind.GARBAGE and device.truth.data_names:
        for each in measured(device):
            assert set(np.diff(places(device, run, each))) <= {1}


@every(FaultKind.LATE)
async def test_answers_that_come_after_all_limits_hinder_no_later_connection(
    device: VirtualDevice, kind: FaultKind
) -> None:
    name = measured(device)[0]
    async with told_the_truth(device) as run:
        device.apply(Fault(kind, TOO_LATE_S))
        await asyncio.sleep(TOO_LATE_S / 3)
        # From now on it answers at once, and what it answers to those before still comes.
        device.clear(kind)
        await run.goes_on(COUNT, name)
        await asyncio.sleep(2 * TOO_LATE_S)
        assert run.supervisor.connections == 2
        await run.goes_on(COUNT, name)
        assert run.supervisor.state is State.STREAMING


@every(*CANNOT_BE)
async def test_what_cannot_be_is_said_and_not_sent(device: VirtualDevice, kind: FaultKind) -> None:
    async with streaming(device) as run:
        run.may_refuse = True
        await until(run.sink.has(COUNT, "quality"))
        device.apply(Fault(kind, LONG_S if kind is FaultKind.REPEAT else 3.0))
        books = list(run.sink.refused.values())
        await until(lambda: any(each.count(Refusal.IMPLAUSIBLE) for each in books))
        assert sum(each.refused for each in run.sink.counters.values()) > 0
        assert run.states == STREAMS


@every(FaultKind.DENY)
async def test_each_signal_that_is_refused_is_a_reason(
    device: VirtualDevice, kind: FaultKind
) -> None:
    found: list[str] = []
    async with streaming(device) as run:
        await until(lambda: run.supervisor.connections == 1)
        while len(found) < MOST_DENIED:
            device.apply(Fault(kind, LONG_S))
            # Where nothing else is left, it is no connection.
            await until(lambda: bool(run.error))
            await until(lambda: run.supervisor.state in (State.STREAMING, State.BACKOFF))
            await until(lambda: any(each in run.error for each in REFUSES))
            if run.error in found:
                break
            found.append(run.error)
            device.clear(kind)
            device.apply(Fault(FaultKind.RESTART, SHORT_S))
            await until(lambda: run.supervisor.state is not State.STREAMING)
            await until(lambda: run.supervisor.state is State.STREAMING)
            await until(lambda: run.supervisor.last_error is None)
    assert len(found) >= device.expected.deniable
    # It is worn all the time, also where nobody measures what that is told from.
    for data_name, column, _ in declaration(device.sensor).channels_of(ChannelRole.CONTACT):
        assert 0 not in [row[column] for row in run.sink.rows[data_name]], data_name


@every(FaultKind.UNREADABLE)
async def test_data_that_nobody_can_read_are_a_state_and_a_reason(
    device: VirtualDevice, kind: FaultKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = measured(device)[0]
    if not is_outside_time(device):
        monkeypatch.setattr(supervisor, "PATIENCE_S", 1.0)
    async with told_the_truth(device) as run:
        begin_s = run.sink.clock()
        device.apply(Fault(kind, LONG_S))
        await until(lambda: run.supervisor.state is not State.STREAMING)
        if is_outside_time(device):
            assert run.sink.clock() - begin_s <= PATIENCE_S + MESSAGE_S
        assert "unreadable bytes came" in str(run.supervisor.last_error)
        count = len(run.sink.rows[name])
        # Some drivers connect only to what they can read.
        await until(lambda: run.supervisor.connections == 2 or State.BACKOFF in run.states)
        assert run.states.count(State.STREAMING) == 1
        assert run.supervisor.last_error
        assert len(run.sink.rows[name]) == count
        device.clear(kind)
        await run.goes_on(COUNT, name)
        await until(lambda: run.supervisor.last_error is None)
        assert run.supervisor.state is State.STREAMING


def role_of(device: VirtualDevice, role: ChannelRole) -> tuple[str, int]:
    """Return data name and column of the channel that has it."""
    data_name, column, _ = next(declaration(device.sensor).channels_of(role))
    return data_name, column


def contact_of(device: VirtualDevice) -> Contact:
    """Return where it shows whether the device is worn."""
    return device.expected.contact or Contact(*role_of(device, ChannelRole.CONTACT))


@every(FaultKind.OFF_BODY)
async def test_a_device_that_is_taken_off_tells_so_and_makes_no_values_up(
    device: VirtualDevice, kind: FaultKind
) -> None:
    contact = contact_of(device)

    def tells() -> float | None:
        rows = run.sink.rows[contact.data_name]
        return rows[-1][contact.channel] if rows else None

    async with told_the_truth(device) as run:
        await until(lambda: tells() not in (None, contact.off))
        device.apply(Fault(kind, LONG_S))
        await until(lambda: tells() == contact.off)
        for name in device.expected.without_contact:
            if declaration(device.sensor).stream(name).is_regular and run.sink.rows[name]:
                await until(lambda name=name: np.isnan(run.sink.values(name)[-1]))
        device.clear(kind)
        await until(lambda: tells() != contact.off)


@every(FaultKind.LOW_BATTERY)
async def test_a_low_battery_is_told(device: VirtualDevice, kind: FaultKind) -> None:
    data_name, column = role_of(device, ChannelRole.STATE_OF_CHARGE)
    device.apply(Fault(kind, VALUES[kind]))
    async with streaming(device) as run:
        await until(lambda: run.sink.rows[data_name])
        assert run.sink.rows[data_name][-1][column] <= LOW_PERCENT


async def test_closing_disconnects(device: VirtualDevice) -> None:
    async with connected(device):
        pass
    async with connected(device):
        pass


async def test_closing_before_connecting_and_twice_does_nothing(device: VirtualDevice) -> None:
    sink = NotedSink(device.sensor, device.world.clock)
    made = driver_maker(device, sink)()
    await made.close()
    await made.close()


@pytest.mark.parametrize("patience_s", [0.0, 0.02, 0.2])
async def test_who_gives_up_connecting_leaves_nothing_half_open(
    device: VirtualDevice, patience_s: float
) -> None:
    given_up = driver_maker(device, NotedSink(device.sensor, device.world.clock))()
    with suppress(TimeoutError):
        await asyncio.wait_for(given_up.connect(), patience_s)
    await given_up.close()
    async with streaming(device) as run:
        await until(run.sink.has(1, measured(device)[0]))
        assert run.supervisor.connections == 1


async def test_a_device_that_is_gone_is_a_known_error(device: VirtualDevice) -> None:
    device.apply(Fault(FaultKind.DROP, float("inf")))
    made = driver_maker(device, NotedSink(device.sensor, device.world.clock))()
    with pytest.raises(GatewayError):
        await made.connect()
    await made.close()


@ON_AIR
async def test_bluetooth_that_is_off_is_said(device: VirtualDevice, radio: Radio) -> None:
    radio.available = False
    with pytest.raises(TransportError) as caught:
        async with connected(device):
            pass
    assert caught.value.reason is TransportReason.UNAVAILABLE


@ON_AIR
async def test_a_serial_port_with_the_name_of_the_device_is_not_the_device(
    device: VirtualDevice,
) -> None:
    (seen,) = await ble_scanner.scan(1.0)
    recognise = driver(device.sensor).recognise
    assert recognise is None or recognise(SerialPort("COM7", seen.name)) is None


@ON_AIR
async def test_who_is_not_there_yet_is_waited_for(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.3)
    device = make()
    async with streaming(device) as run:
        await until(lambda: run.supervisor.last_error)
        assert run.supervisor.connections == 0
        with device:
            await until(run.sink.has(1, measured(device)[0]))


def test_settings_of_another_sensor_are_a_mistake(name: str) -> None:
    sensor = class_of(name).sensor
    with pytest.raises(TypeError):
        driver(sensor).make(DeviceSettings(sensor="other", unit="x"), NotedSink(sensor))


async def test_a_device_that_is_switched_on_later_is_found(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = make()
    with device:
        for variable, text in device.environment.items():
            monkeypatch.setenv(variable, text)
        device.apply(Fault(FaultKind.DROP, float("inf")))
        async with streaming(device) as run:
            await until(lambda: run.supervisor.last_error)
            assert run.supervisor.connections == 0
            device.clear(FaultKind.DROP)
            await until(run.sink.has(1, measured(device)[0]))
