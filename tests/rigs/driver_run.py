"""A driver under its supervisor, and all that it emits."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected, Driver
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.registry import driver as driver_of
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from tests.rigs.polling import until


class NotedSink(DeviceSink):
    """Notes what drivers emit on its way into LSL.

    Parameters
    ----------
    spec
        What the device emits, where that is not what its sensor declares.
    """

    def __init__(
        self, sensor: str, clock: Clock = LSL_CLOCK, spec: SensorSpec | None = None
    ) -> None:
        self._spec = spec or declaration(sensor)
        super().__init__(DeviceIdentity(sensor, uuid.uuid4().hex), self._spec, clock)
        names = [stream.data_name for stream in self._spec.streams]
        # rows, times: samples of each stream, and their LSL times [s].
        self.rows: dict[str, list[list[float]]] = {name: [] for name in names}
        self.times: dict[str, list[float]] = {name: [] for name in names}
        # Those of the device's clock [s], where it stamps them.
        self.device_times: dict[str, list[float]] = {name: [] for name in names}
        self.texts: list[str] = []  # Of all streams of text; their times are in `times`.
        # info, rates: of the newest connection.
        self.info = DeviceInfo()
        self.rates: Mapping[str, float] = {}
        self._kept: dict[str, Counters] = {}

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters of all streams, also after the end."""
        return super().counters or self._kept

    @property
    def losses(self) -> dict[str, int]:
        """How many samples are counted as lost, by data name of the streams that lost any."""
        names = {source_id(self.identity, each): each for each in self.rows}
        return {names[key]: each.lost for key, each in self.counters.items() if each.lost}

    def open(self, info: DeviceInfo, rates: Mapping[str, float]) -> None:
        """Note what the device is."""
        super().open(info, rates)
        self.info, self.rates = info, rates

    def close(self) -> None:
        """Keep the counters."""
        self._kept = self.counters
        super().close()

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        """Note when the device says that samples were measured."""
        super().emit(data_name, samples, device_times)
        self.device_times[data_name] += device_times

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        """Note samples; those that the device stamps pass here as well."""
        super().emit_at(data_name, samples, lsl_times)
        width = len(self._spec.stream(data_name).channels)
        self.rows[data_name] += np.asarray(samples, np.float64).reshape(-1, width).tolist()
        self.times[data_name] += lsl_times

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Note a text."""
        super().emit_text(data_name, text, device_s)
        self.texts.append(text)
        self.times[data_name].append(self._clock.to_lsl(device_s))

    def values(self, data_name: str) -> list[float]:
        """Return the first channel of a stream."""
        return [row[0] for row in self.rows[data_name]]

    def array(self, data_name: str) -> NDArray[np.float64]:
        """Return all samples of a stream; shape (samples, channels)."""
        width = len(self._spec.stream(data_name).channels)
        return np.array(self.rows[data_name], np.float64).reshape(-1, width)

    def has(self, count: int, *data_names: str) -> Callable[[], bool]:
        """Return a condition: so many samples of each have come."""
        return lambda: all(len(self.rows[name]) >= count for name in data_names)

    def counted(self, data_name: str) -> Counters:
        """Return the counters of a stream."""
        return self.counters[source_id(self.identity, data_name)]

    def lost_count(self, data_name: str) -> int:
        """Return how many samples of a stream are counted as lost."""
        return self.counted(data_name).lost


class Run:
    """The supervisor of a device, and what came of it.

    Attributes
    ----------
    states
        All that it has been in.
    """

    may_refuse = False  # Whether the device sends what cannot be.

    def __init__(self, device: VirtualDevice, /, **fields: Any) -> None:
        sink = NotedSink(device.sensor, device.world.clock)
        self._begin(sink, driver_maker(device, sink, **fields))

    def _begin(self, sink: NotedSink, make: Callable[[], Driver]) -> None:
        self.sink = sink
        self.states: list[State] = []
        self.supervisor = Supervisor(make, sink, self.states.append)

    @property
    def lost(self) -> dict[str, int]:
        """How many samples are counted as lost, by data name of the streams that lost any."""
        return self.sink.losses

    @property
    def error(self) -> str:
        """Why there is no connection, or was none last; empty if nothing is wrong."""
        return self.supervisor.last_error or ""

    def is_streaming(self) -> bool:
        """Whether all that is due comes."""
        return self.supervisor.state is State.STREAMING

    async def goes_on(self, count: int, *data_names: str) -> None:
        """Wait until so many further samples of each have come."""
        wanted = {name: len(self.sink.rows[name]) + count for name in data_names}
        await until(lambda: all(len(self.sink.rows[name]) >= wanted[name] for name in wanted))


_R = TypeVar("_R", bound=Run)


@asynccontextmanager
async def streaming(device: VirtualDevice, /, **fields: Any) -> AsyncGenerator[Run]:
    """Run until the block ends; then nothing may have been refused or be half closed.

    Fields are those of the device's settings, besides the ones that lead to the virtual device.
    """
    async with supervised(Run(device, **fields)) as run:
        yield run


@asynccontextmanager
async def supervised(run: _R) -> AsyncGenerator[_R]:
    """Run what is made already; see :func:`streaming`."""
    task = asyncio.create_task(run.supervisor.run())
    try:
        yield run
    finally:
        task.cancel()
        await asyncio.wait({task}, timeout=20)
        run.sink.close()
    assert run.states[-1] is State.STOPPED
    assert run.may_refuse or {each.refused for each in run.sink.counters.values()} <= {0}


@asynccontextmanager
async def connected(device: VirtualDevice, /, **fields: Any) -> AsyncGenerator[Connected]:
    """Connect once, without a supervisor."""
    driver = driver_maker(device, NotedSink(device.sensor, device.world.clock), **fields)()
    try:
        yield await driver.connect()
    finally:
        await driver.close()


def driver_maker(device: VirtualDevice, sink: NotedSink, /, **fields: Any) -> Callable[[], Driver]:
    """Return what makes a driver for each connection to a virtual device."""
    entry = driver_of(device.sensor)
    named = {"sensor": device.sensor, "unit": sink.identity.unit}
    settings = entry.settings.model_validate({**named, **device.settings, **fields})
    return entry.make(settings, sink)
