"""Devices that are untidy as real ones: each sample comes once, and has its own time."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_common.naming import source_id
from biosensor_common.quantities import ChannelRole
from biosensor_common.refusal import Refusal
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.simulation.faults import Fault, FaultKind, Untidiness
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.transports import ble_choice, ble_scanner
from tests.contracts.conftest import NAMES, class_of, every
from tests.contracts.test_any_driver import COUNT, LONG_S, measured, places, role_of
from tests.rigs.driver_run import Run, streaming
from tests.rigs.patients import Patient, ramp
from tests.rigs.polling import until

if TYPE_CHECKING:
    from _pytest.mark import ParameterSet

    from tests.contracts.conftest import Make
    from tests.rigs.truth import Floats

BUNDLE_S = 3.0
SETTLED_S, LATER_S = 8.0, 14.0
"""Until the clocks of all devices are known; then for so long."""
STAMP_LIMIT_S = 0.06
LONG_BUNDLES_S = (5.5, 8.0)
BUNDLES_LONG = [each for each in NAMES if class_of(each).expected.bundles_s >= max(LONG_BUNDLES_S)]
LONG_LIMIT_S = 0.15
"""Data are missed meanwhile, and asked for again. Of a frame from before the stop and one from
behind it nothing tells, if a tenth of a frame is missing between them: Verity Sense has frames of
73 samples at 52 Hz."""
BROKEN_S, BROKEN_TOO_S = (9.0, 17.0), (10.0, 12.0, 25.0)
"""The connection is made again, once or more, while what was sent on it waits."""
LINKED = [
    each
    for each in NAMES
    if Untidiness.BUNDLED in class_of(each).effects and class_of(each).expected.is_linked
]
BY_ARRIVAL = ("hr", "ibi")
UNSTAMPED_LIMIT_S = 1.5
"""So much at most lies between two packets that the device stamps."""
RATES_HZ = (100.0, 50.0)
"""One of them is another than in the settings."""
HARMLESS = (Untidiness.APART, Untidiness.OVERTAKEN, Untidiness.GLUED, Untidiness.BUNDLED)


def _nightly(bundle_s: float) -> ParameterSet:
    return pytest.param(bundle_s, marks=pytest.mark.nightly)


def assert_true(
    device: VirtualDevice,
    run: Run,
    since_s: float,
    waits_s: float = 0.0,
    *,
    has_gaps: bool = False,
    limit_s: float = STAMP_LIMIT_S,
) -> None:
    """Assert that what came is what was measured, each once, whole, and stamped with its time.

    Parameters
    ----------
    since_s
        From this stamp on.
    waits_s
        So long may what the device does not stamp have waited.
    has_gaps
        Whether the link was broken.
    limit_s
        By so much may stamps be wrong.
    """
    if not device.truth.data_names:
        return  # a recording, of which nobody knows more than what it holds
    first, *_ = measured(device)
    assert has_gaps or max(run.sink.times[first]) > since_s + COUNT
    for name in measured(device):
        truth = device.truth.samples(name)
        has_value = ~np.isnan(truth.values).all(axis=1)
        index = np.array(places(device, run, name), np.int64)
        if not has_gaps:
            assert np.all(np.diff(index) == 1), f"{name}: samples are missing"
            assert run.sink.lost_count(name) == 0, name
            is_open = source_id(run.sink.identity, name) in run.sink.counters
            due = truth.times[has_value] < since_s
            assert len(index) or not is_open or not due.any(), f"{name} stays empty"
        came = ~np.isnan(run.sink.array(name)).all(axis=1)
        stamps = np.array(run.sink.times[name])[came]
        errors_s = (stamps - truth.times[has_value][index])[stamps >= since_s]
        late_s = device.expected.unstamped_s.get(name)
        if not len(errors_s):
            continue
        if late_s is None:
            assert np.abs(errors_s).max() < limit_s, (name, errors_s)
        else:
            # It is as old as the packet before it, where both had waited.
            early_s = late_s + (UNSTAMPED_LIMIT_S if waits_s else 0.0)
            assert errors_s.min() > -early_s - STAMP_LIMIT_S, (name, errors_s)
            assert errors_s.max() < late_s + waits_s + STAMP_LIMIT_S, (name, errors_s)


@every(*HARMLESS)
async def test_what_is_untidy_is_whole_and_has_its_time(
    device: VirtualDevice, kind: Untidiness
) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        await asyncio.sleep(SETTLED_S)
        begin_s = run.sink.clock()
        value = BUNDLE_S if kind is Untidiness.BUNDLED else LONG_S
        device.apply(Fault(kind, value))
        await asyncio.sleep(LATER_S)
        device.clear(kind)
        await asyncio.sleep(BUNDLE_S)
        assert run.states == [State.CONNECTING, State.STREAMING]
        assert not run.error
    assert_true(device, run, begin_s, BUNDLE_S)


@pytest.mark.parametrize("bundle_s", LONG_BUNDLES_S)
@pytest.mark.parametrize("name", BUNDLES_LONG, indirect=True)
async def test_what_waits_together_for_long_is_no_clock_that_was_set(
    device: VirtualDevice, bundle_s: float
) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        await asyncio.sleep(SETTLED_S)
        begin_s = run.sink.clock()
        device.apply(Fault(Untidiness.BUNDLED, bundle_s))
        await asyncio.sleep(LATER_S + bundle_s)
        device.clear(Untidiness.BUNDLED)
        await asyncio.sleep(BUNDLE_S)
        assert run.supervisor.connections == 1
        assert State.ENABLING in run.states
    assert run.sink.clock_state.reanchors == 0
    # What was asked for again was stopped before.
    assert_true(device, run, begin_s, bundle_s, has_gaps=True, limit_s=LONG_LIMIT_S)


@pytest.mark.parametrize("bundle_s", [*BROKEN_S, *(_nightly(each) for each in BROKEN_TOO_S)])
@pytest.mark.parametrize("name", LINKED, indirect=True)
async def test_what_waits_longer_than_the_connection_lasts_is_right_or_said(
    make: Make, bundle_s: float
) -> None:
    with make(wearer=Patient(beats_s=ramp(200, 60, 170))) as device:
        async with streaming(device) as run:
            await until(run.sink.has(COUNT, *measured(device)[:1]))
            await asyncio.sleep(SETTLED_S)
            begin_s = run.sink.clock()
            device.apply(Fault(Untidiness.BUNDLED, bundle_s))
            await asyncio.sleep(2.5 * bundle_s)
            device.clear(Untidiness.BUNDLED)
            await asyncio.sleep(SETTLED_S)
            late = {
                name: run.sink.refused[source_id(run.sink.identity, name)].count(Refusal.LATE)
                for name in measured(device)
            }
        # Nobody switched it off; some devices count from each start.
        assert not run.sink.clock_state.reanchors or device.expected.loss_tolerance.by_arrival
        for name in measured(device):
            if name in device.expected.unstamped_s or name in BY_ARRIVAL:
                # A heart rate is as old as the packet before it.
                errors_s = errors_by_value(device, run, name, begin_s)
                assert np.count_nonzero(errors_s > UNSTAMPED_LIMIT_S) <= late[name], name
                # Intervals tell the times of each other.
                assert name != "ibi" or errors_s.max(initial=0.0) < UNSTAMPED_LIMIT_S, errors_s
            else:
                errors_s = errors_by_place(device, run, name, begin_s)
                assert np.abs(errors_s).max(initial=0.0) < LONG_LIMIT_S, (name, errors_s)


def errors_by_place(device: VirtualDevice, run: Run, name: str, since_s: float) -> Floats:
    """Return how far stamps are from the measurements of what came, which is no value twice."""
    truth = device.truth.samples(name)
    index = np.array(places(device, run, name), np.int64)
    stamps = np.array(run.sink.times[name])[~np.isnan(run.sink.array(name)).all(axis=1)]
    true_s = truth.times[~np.isnan(truth.values).all(axis=1)][index]
    return (stamps - true_s)[stamps >= since_s]


def errors_by_value(device: VirtualDevice, run: Run, name: str, since_s: float) -> Floats:
    """Return how far stamps are from the nearest measurement of the same value, in s."""
    truth = device.truth.samples(name)
    found: list[float] = []
    for row, stamp in zip(run.sink.array(name), run.sink.times[name], strict=True):
        if stamp >= since_s and not np.isnan(row).any():
            same = np.isclose(truth.values, row, rtol=1e-5).all(axis=1)
            apart = stamp - truth.times[same]
            found.append(apart[np.argmin(np.abs(apart))])
    return np.array(found)


@every(Untidiness.NAMELESS)
async def test_a_device_without_a_name_is_found_by_its_address(
    device: VirtualDevice, kind: Untidiness
) -> None:
    device.apply(Fault(kind, LONG_S))
    (seen,) = await ble_scanner.scan(1.0)
    assert not seen.name
    async with streaming(device, device=seen.address) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        begin_s = run.sink.clock() + SETTLED_S
        await asyncio.sleep(2 * SETTLED_S)
    assert_true(device, run, begin_s)


@every(Untidiness.READDRESSED)
async def test_a_device_under_another_address_is_nobody_until_the_settings_say_so(
    device: VirtualDevice, kind: Untidiness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "SCAN_S", 1.0)
    name = measured(device)[0]
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, name))
        device.apply(Fault(kind, LONG_S))
        await until(lambda: "another" in run.error)
        assert "5E:" in run.error
        assert "set `device` to" in run.error
        assert run.supervisor.connections == 1
        device.clear(kind)
        await until(lambda: run.supervisor.connections == 2)
        begin_s = run.sink.clock() + SETTLED_S
        await asyncio.sleep(2 * SETTLED_S)
    assert min(abs(t - begin_s) for t in run.sink.times[name]) < COUNT
    # A broadcast does not say which measurement it is of: behind a silence that is an estimate.
    if not device.only_advertises:
        assert_true(device, run, begin_s, has_gaps=True)


@every(FaultKind.DENY)
async def test_signals_that_are_not_refused_keep_their_times(
    device: VirtualDevice, kind: FaultKind
) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        device.apply(Fault(kind, LONG_S))
        await until(lambda: run.supervisor.connections == 2)
        denied = set(run.sink.watch.denied)
        assert denied
        assert all(each in run.error for each in denied)
        begin_s = run.sink.clock() + SETTLED_S
        await asyncio.sleep(2 * SETTLED_S)
        came = {name for name, times in run.sink.times.items() if times and times[-1] > begin_s}
        assert came >= set(measured(device)[:2]) - denied
        assert not came & denied
    assert_true(device, run, begin_s, has_gaps=True)


@every(FaultKind.LOW_BATTERY)
async def test_a_full_battery_is_full(device: VirtualDevice, kind: FaultKind) -> None:
    data_name, column = role_of(device, ChannelRole.STATE_OF_CHARGE)
    device.apply(Fault(kind, 100.0))
    async with streaming(device) as run:
        await until(lambda: run.sink.rows[data_name])
        assert 99.0 <= run.sink.rows[data_name][-1][column] <= 100.0


@every(Untidiness.STRAY)
async def test_messages_that_mean_nothing_cost_no_sample(
    device: VirtualDevice, kind: Untidiness
) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        await asyncio.sleep(SETTLED_S)
        begin_s = run.sink.clock()
        device.apply(Fault(kind, 3.0))
        await asyncio.sleep(LATER_S)
        assert run.states == [State.CONNECTING, State.STREAMING]
    assert_true(device, run, begin_s)


@every(Untidiness.RATE)
async def test_a_rate_that_is_not_declared_is_said_with_both_rates(
    device: VirtualDevice, kind: Untidiness
) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        hz = next(each for each in RATES_HZ if each != device.settings.get("rate_hz"))
        device.apply(Fault(kind, hz))
        await until(lambda: f"{hz:g} times per second" in run.error)
        assert "set `" in run.error
        device.clear(kind)
        await until(lambda: not run.error)


@every(Untidiness.PACE)
@pytest.mark.parametrize("percent", [-20.0, 4.0, 100.0])
async def test_a_sensor_that_is_not_as_fast_as_declared_is_said_and_has_its_time(
    device: VirtualDevice, kind: Untidiness, percent: float
) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(COUNT, *measured(device)[:1]))
        device.apply(Fault(kind, percent))
        await until(lambda: "times per second, but its header says" in run.error)
        # What was stamped ahead of its time has to be caught up with.
        begin_s = run.sink.clock() + SETTLED_S / 2
        await asyncio.sleep(1.5 * SETTLED_S)
        assert_true(device, run, begin_s, has_gaps=True)
        device.clear(kind)
        await until(lambda: not run.error)


def test_there_is_a_device_for_each_untidiness() -> None:
    kinds = {kind for name in NAMES for kind in class_of(name).effects}
    assert kinds >= set(Untidiness)
