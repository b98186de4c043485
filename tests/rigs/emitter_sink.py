"""Where an emitter's test finds what was emitted, without LSL."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.spec import DeviceIdentity, SensorSpec
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink


class EmitterSink(DeviceSink):
    """Notes what it is told instead of telling LSL; its device clock is real."""

    def __init__(self, sensor: str, spec: SensorSpec | None = None) -> None:
        super().__init__(DeviceIdentity(sensor, "noted"), spec or declaration(sensor))
        # Samples by data name, in the declared number of channels; none for what never came.
        self.emitted: dict[str, list[list[float]]] = {}
        # times, device_times, lsl_times: their times by data name [s]; in the last two, only those
        # on that clock.
        self.times: dict[str, list[float]] = {}
        self.device_times: dict[str, list[float]] = {}
        self.lsl_times: dict[str, list[float]] = {}
        # Of each its data name, itself and its device time [s].
        self.texts: list[tuple[str, str, float]] = []
        self.observed: list[tuple[float, float]] = []  # Device time and arrival of each packet [s].
        self.losses: dict[str, int] = {}  # Samples lost, by data name.
        # `observe`, `restart_clock` and data names, in the order of the calls.
        self.calls: list[str] = []
        # For each restart of the clock, how much had been observed before.
        self.restarts: list[int] = []
        self.heard_count = 0  # How often something valid without a sample was told of.

    def values(self, data_name: str) -> list[float]:
        """Return the first channel of a stream."""
        return [row[0] for row in self.emitted.get(data_name, [])]

    def mapped(self, device_s: float) -> float:
        """Return a device time on LSL's clock; it fails before anything was observed."""
        return self._clock.to_lsl(device_s)

    def heard(self, *data_names: str) -> None:
        """Count."""
        super().heard(*data_names)
        self.heard_count += 1

    def observe(self, device_s: float, arrival_s: float, kind: str = "") -> None:
        """Note the times of a packet."""
        super().observe(device_s, arrival_s, kind)
        self.calls.append("observe")
        self.observed.append((device_s, arrival_s))

    def restart_clock(self) -> None:
        """Note how much was observed before."""
        super().restart_clock()
        self.calls.append("restart_clock")
        self.restarts.append(len(self.observed))

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        """Note samples that the device stamps; the clock must be able to map them."""
        for time in device_times:
            self.mapped(time)
        self._note(data_name, samples, device_times)
        self.device_times.setdefault(data_name, []).extend(device_times)

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        """Note samples that the device does not stamp."""
        self._note(data_name, samples, lsl_times)
        self.lsl_times.setdefault(data_name, []).extend(lsl_times)

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Note a text."""
        self.mapped(device_s)
        self.texts.append((data_name, text, device_s))

    def lost(self, data_name: str, count: int) -> None:
        """Note losses, also of none: who tells of those shows in `losses`."""
        assert count >= 0
        self.losses[data_name] = self.losses.get(data_name, 0) + count

    def _note(self, data_name: str, samples: ArrayLike, times: Sequence[float]) -> None:
        width = len(self.spec.stream(data_name).channels)
        rows = np.asarray(samples, np.float64).reshape(-1, width).tolist()
        assert len(rows) == len(times) > 0
        self.calls.append(data_name)
        self.emitted.setdefault(data_name, []).extend(rows)
        self.times.setdefault(data_name, []).extend(times)
