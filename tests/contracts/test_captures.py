"""What is captured of any device, and replayed, gives the same samples at the same times."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import ArrayLike

from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity, SensorSpec
from biosensor_gateway.captures.file import Capture, packed, read
from biosensor_gateway.captures.recorder import taken
from biosensor_gateway.captures.redaction import LEAST_SEARCHED
from biosensor_gateway.captures.replay import ReplaySink, Report, replay
from biosensor_gateway.devices.registry import driver
from biosensor_gateway.doctor.device_test import DeviceTest
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.system.clock import Clock
from biosensor_gateway.transports.tap import Tap, tapped
from tests.contracts.conftest import NAMES, class_of
from tests.rigs.driver_run import streaming

if TYPE_CHECKING:
    from tests.contracts.conftest import Make

SECONDS = 5.0
SAME_S = 1e-4
"""A file has microseconds; what maps a device's clock adds some of them up."""
_ON_AIR = [each for each in NAMES if class_of(each).on_air]
CONNECTED = pytest.mark.parametrize(
    "name", [each for each in _ON_AIR if not class_of(each).only_advertises], indirect=True
)
ADVERTISING = pytest.mark.parametrize(
    "name", [each for each in _ON_AIR if class_of(each).only_advertises], indirect=True
)
FIRST = [next(each for each in NAMES if class_of(each).on_air), NAMES[-1]]
BY_BYTES = pytest.mark.parametrize(
    "name", [each for each in NAMES if not class_of(each).on_air], indirect=True
)


class Kept:
    """Samples by data name, and their times."""

    def __init__(self) -> None:
        self.rows: dict[str, list[list[float]]] = {}
        self.times: dict[str, list[float]] = {}

    def take(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        rows = np.asarray(samples, np.float64).reshape(len(stamps), -1)
        self.rows.setdefault(data_name, []).extend(rows.tolist())
        self.times.setdefault(data_name, []).extend(stamps)


async def captured(device: VirtualDevice, *faults: Fault, seconds: float = SECONDS) -> Captured:
    """Capture a device for some seconds, with faults in the middle."""
    tap, kept = Tap(device.world.clock), Kept()
    with tapped(tap):
        async with streaming(device) as run:
            run.sink.tap = kept.take
            await asyncio.sleep(seconds / 2)
            for fault in faults:
                device.apply(fault)
            await asyncio.sleep(seconds / 2)
            tap.end()
            run.sink.tap = None
            lost = run.lost
    fields = {"sensor": device.sensor, "unit": "SECRET1", **device.settings}
    settings = driver(device.sensor).settings.model_validate(fields)
    return Captured(taken(tap, settings, DeviceTest(info=run.sink.info)).capture, kept, lost)


class Captured:
    """A capture, with what was emitted while it was made."""

    def __init__(self, capture: Capture, kept: Kept, lost: dict[str, int]) -> None:
        self.capture, self.kept, self.lost = capture, kept, lost


async def replayed(capture: Capture) -> tuple[Report, Kept]:
    kept = Kept()

    def make(identity: DeviceIdentity, spec: SensorSpec, clock: Clock) -> ReplaySink:
        sink = ReplaySink(identity, spec, clock)
        note = sink.tap
        assert note is not None

        def both(data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
            note(data_name, samples, stamps)
            kept.take(data_name, samples, stamps)

        sink.tap = both
        return sink

    return await asyncio.to_thread(replay, capture, make_sink=make), kept


def assert_same(then: Kept, now: Kept) -> None:
    """All samples are the same, and all times but for one constant of the whole capture."""
    assert now.rows.keys() == then.rows.keys()
    shifts: list[float] = []
    for name, rows in then.rows.items():
        np.testing.assert_array_equal(now.rows[name], rows, err_msg=name)
        shifts += list(np.subtract(now.times[name], then.times[name]))
    assert shifts
    assert np.ptp(shifts) < SAME_S


def assert_tells_nothing(capture: Capture, device: VirtualDevice) -> None:
    """Nothing that leads to the device stands in its capture, in any spelling."""
    seen = capture.events[0].seen
    told = capture.header.model_dump_json() + ("" if seen is None else seen.model_dump_json())
    payloads = [each.data for each in capture.events]
    kept = capture.header.settings.values()
    own = [each for each in device.settings.values() if each not in kept]
    secrets = [each for each in own if isinstance(each, str)]
    for secret in (each for each in (*secrets, "SECRET1") if len(each) >= LEAST_SEARCHED):
        assert secret.casefold() not in told.casefold()
        octets = secret.casefold().split(":")
        forms = [each.encode().hex() for each in (secret, secret.lower(), "".join(octets))]
        if len(octets) > 1:
            forms += ["".join(octets), "".join(reversed(octets))]
        assert not [each for each in payloads if any(form in each for form in forms)]


@ADVERTISING
async def test_what_nothing_connects_to_cannot_be_captured(device: VirtualDevice) -> None:
    with pytest.raises(ConfigError, match="without a connection"):
        await captured(device)


@CONNECTED
async def test_a_device_on_the_air_is_replayed_as_it_was(
    device: VirtualDevice, tmp_path: Path
) -> None:
    then = await captured(device)
    assert_tells_nothing(then.capture, device)
    file = tmp_path / "one.capture.gz"
    file.write_bytes(packed(then.capture))
    report, now = await replayed(read(file))
    assert (report.problems, report.notes, report.sentences) == ([], [], [])
    assert_same(then.kept, now)


@BY_BYTES
async def test_a_device_behind_a_port_is_replayed_as_it_was(device: VirtualDevice) -> None:
    try:
        then = await captured(device)
    except ConfigError as error:
        # Only where no bytes pass.
        assert "values and not the device's bytes" in str(error)
        assert not device.settings.keys() & {"port", "host", "url", "udp_port"}
        return
    assert_tells_nothing(then.capture, device)
    report, now = await replayed(then.capture)
    assert report.problems == []
    assert report.notes == []
    assert_same(then.kept, now)


@pytest.mark.parametrize("name", FIRST, indirect=True)
async def test_a_link_that_broke_breaks_again(make: Make) -> None:
    with make() as device:
        then = await captured(device, Fault(FaultKind.DROP, 3.0), seconds=12.0)
    assert len(then.capture.of_links()) == 2
    report, now = await replayed(then.capture)
    assert report.connections == 2
    assert {each: report.streams[each].lost for each in then.lost} == then.lost
    for data_name, rows in then.kept.rows.items():
        np.testing.assert_array_equal(now.rows[data_name], rows)
