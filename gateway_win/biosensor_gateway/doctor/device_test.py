"""Tests one device: connects to it for some seconds, and checks its samples."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.quantities import ChannelRole
from biosensor_common.spec import IRREGULAR, DeviceInfo, SensorSpec
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declared, driver
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.sink import DeviceSink

CONNECT_TIMEOUT_S = 60.0
RATE_TOLERANCE = 0.1
SETTLING_S = 1.0
"""Time until the device's clock is known: after a late first packet, stamps are too close."""
_POLL_S = 0.05


class StreamTestResult(BaseModel):
    """Outcome of one stream in a test."""

    samples: int
    nominal_hz: float  # Nominal rate; 0 for irregular streams.
    measured_hz: float | None  # Rate by the samples' stamps; None if unknown.
    last: list[float | str | None]  # Newest values, or text.


class DeviceTestResult(BaseModel):
    """Outcome of a device's test, for JSON."""

    connected: bool
    # model, serial_number, firmware_version: none if it never connected.
    model: str | None
    serial_number: str | None
    firmware_version: str | None
    problems: list[str]  # One sentence each; empty if nothing is wrong.
    streams: dict[str, StreamTestResult]  # By data name.


@dataclass(slots=True)
class StreamTest:
    """Measurements of one stream."""

    samples: int = 0
    # first_s, last_s: LSL times of the first and the newest sample.
    first_s: float = 0.0
    last_s: float = 0.0
    # settled_samples, settled_s: number of samples, and LSL time of the newest, when the device's
    # clock was known; 0 before.
    settled_samples: int = 0
    settled_s: float = 0.0
    last: tuple[float | str, ...] = ()  # Newest values, or text.
    nominal_hz: float = 0.0  # 0 for an irregular stream.
    units: tuple[str, ...] = ()

    @property
    def measured_hz(self) -> float | None:
        """Effective rate by the samples' stamps; None if unknown."""
        is_settled = 0 < self.settled_samples < self.samples
        before = self.settled_samples if is_settled else 1
        elapsed_s = self.last_s - (self.settled_s if is_settled else self.first_s)
        return (self.samples - before) / elapsed_s if self.samples > 1 and elapsed_s > 0 else None

    def take(self, times: Sequence[float]) -> None:
        """Note samples by their LSL times."""
        if not self.samples:
            self.first_s = times[0]
        self.samples += len(times)
        self.last_s = times[-1]
        if not self.settled_samples and self.last_s - self.first_s >= SETTLING_S:
            self.settled_samples, self.settled_s = self.samples, self.last_s


@dataclass(slots=True)
class DeviceTest:
    """Outcome of testing one device."""

    info: DeviceInfo | None = None
    streams: dict[str, StreamTest] = field(default_factory=dict[str, StreamTest])
    # One sentence each; empty if nothing is wrong.
    problems: list[str] = field(default_factory=list[str])


class _TestSink(DeviceSink):
    """Notes samples instead of streaming them: an agent may run at the same time."""

    def __init__(self, settings: DeviceSettings) -> None:
        super().__init__(settings.identity, declared(settings))
        self.outcome = DeviceTest()

    def open(self, info: DeviceInfo, rates: Mapping[str, float]) -> None:
        self.outcome.info = info
        for stream in self.spec.streams:
            rate = rates.get(stream.data_name, stream.rate)
            noted = self.outcome.streams.setdefault(stream.data_name, StreamTest())
            noted.nominal_hz = rate if isinstance(rate, float | int) else IRREGULAR
            noted.units = tuple(channel.unit for channel in stream.channels)

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        rows = np.atleast_1d(np.asarray(samples, np.float64))
        if not len(lsl_times):
            return
        self.heard(data_name)
        noted = self.outcome.streams[data_name]
        noted.take(lsl_times)
        noted.last = tuple(float(value) for value in np.atleast_1d(rows[-1]))

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        del device_s
        self.heard(data_name)
        self.outcome.streams[data_name].samples += 1
        self.outcome.streams[data_name].last = (text,)

    def lost(self, data_name: str, count: int) -> None:
        """Ignore losses, because a test is too short to judge them."""


async def run_device_test(
    settings: DeviceSettings, seconds: float, ending: Callable[[], object] = lambda: None
) -> DeviceTest:
    """Connect to a device, receive for *seconds*, and check the samples.

    The device has `CONNECT_TIMEOUT_S` to connect. Nothing is streamed.
    """
    sink = _TestSink(settings)
    supervisor = Supervisor(driver(settings.sensor).make(settings, sink), sink)
    task = asyncio.create_task(supervisor.run())
    try:
        await _until_streaming(supervisor)
        if supervisor.connections:
            await asyncio.sleep(seconds)
        sink.outcome.problems += [
            *_connection_problems(supervisor),
            *_sample_problems(sink.outcome, sink.spec, sink.silent),
        ]
    finally:
        ending()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    return sink.outcome


async def _until_streaming(supervisor: Supervisor) -> None:
    loop = asyncio.get_running_loop()
    deadline = loop.time() + CONNECT_TIMEOUT_S
    # Ends at a refusal, whose sentence is the outcome, and does not wait for another attempt.
    while not supervisor.connections and supervisor.state is not State.BACKOFF:
        if loop.time() > deadline or _has_failed(supervisor):
            return
        await asyncio.sleep(_POLL_S)


def _has_failed(supervisor: Supervisor) -> bool:
    return supervisor.state is State.DISCOVERING and supervisor.last_error is not None


def _connection_problems(supervisor: Supervisor) -> list[str]:
    """Return what went wrong with the connection."""
    if supervisor.last_error is not None:
        return [supervisor.last_error]
    if not supervisor.connections:
        return [f"no connection within {CONNECT_TIMEOUT_S:g} s"]
    if supervisor.connections > 1:
        return [f"the connection broke; it was made {supervisor.connections} times"]
    return []


def _sample_problems(outcome: DeviceTest, spec: SensorSpec, silent: frozenset[str]) -> list[str]:
    """Return what is wrong with the samples, except for streams that are switched off."""
    if outcome.info is None:
        return []
    expected = {name: each for name, each in outcome.streams.items() if name not in silent}
    return [
        *(text for name, each in expected.items() if (text := _rate_problem(name, each))),
        *(
            f"{label} is 0: the sensor does not seem to be on the body"
            for data_name, column, label in spec.channels_of(ChannelRole.CONTACT)
            if (last := outcome.streams[data_name].last) and last[column] == 0
        ),
    ]


def _rate_problem(name: str, noted: StreamTest) -> str:
    """Return what is wrong with the rate of a regular stream; empty if nothing is."""
    if not noted.nominal_hz:
        return ""
    if not noted.samples:
        return f"{name}: no sample arrived"
    rate = noted.measured_hz
    if rate is not None and abs(rate - noted.nominal_hz) > RATE_TOLERANCE * noted.nominal_hz:
        return f"{name}: {rate:.1f} samples a second instead of {noted.nominal_hz:g}"
    return ""


def chosen_device(
    sensor_name: str, unit: str, configured: Sequence[DeviceSettings]
) -> DeviceSettings:
    """Return the settings of the device to test.

    Parameters
    ----------
    unit
        Unit of the device; empty if there is only one of this sensor.
    configured
        Devices of the settings; if none is of this sensor, its default settings are used.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` or ``NOT_FOUND``.
    """
    model = driver(sensor_name).settings
    matching = [
        each
        for each in configured
        if each.sensor == sensor_name and (not unit or each.unit == unit)
    ]
    if len(matching) == 1:
        return matching[0]
    if matching:
        units = ", ".join(each.unit for each in matching)
        message = f"several {sensor_name} are configured; add --unit, one of {units}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    if unit:
        known = ", ".join(each.unit for each in configured if each.sensor == sensor_name)
        message = f"no {sensor_name} {unit} is in the settings; there is {known or 'none'}"
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    required = {name for name, each in model.model_fields.items() if each.is_required()}
    missing = sorted(required - {"sensor", "unit"})
    if missing:
        message = (
            f"no {sensor_name} is in the settings, and it needs {', '.join(missing)}; "
            "`biosensor-gateway scan` shows which devices are there"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return model.model_validate({"sensor": sensor_name, "unit": "trial"})


def described(outcome: DeviceTest) -> DeviceTestResult:
    """Return the model of a test's outcome, for scripts and for the page."""
    info = outcome.info
    return DeviceTestResult(
        connected=info is not None,
        model=info.model if info else None,
        serial_number=info.serial_number if info else None,
        firmware_version=info.firmware_version if info else None,
        problems=outcome.problems,
        streams={
            name: StreamTestResult(
                samples=each.samples,
                nominal_hz=each.nominal_hz,
                measured_hz=each.measured_hz,
                last=[_plain(value) for value in each.last],
            )
            for name, each in outcome.streams.items()
        },
    )


def _plain(value: float | str) -> float | str | None:
    # JSON has no NaN.
    return None if isinstance(value, float) and math.isnan(value) else value
