"""Where a driver puts what it measured: from device time to pushed samples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import structlog
from numpy.typing import ArrayLike
from pylsl import local_clock

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.device_clock import ClockState, DeviceClock
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.outlets import MAX_STAMP_ERROR_S, Counters, DeviceOutlets

_log = structlog.get_logger("biosensor_gateway.sink")


class DeviceSink:
    """One device's clock, outlets and counters; they outlive its connections.

    A driver reports packets with :meth:`observe`, then hands over their samples
    with times on the device's own clock.
    """

    def __init__(self, identity: DeviceIdentity) -> None:
        self.identity = identity
        self._clock = DeviceClock()
        self._outlets = DeviceOutlets(identity)
        self._stamps: dict[str, MonotonicStamps] = {}
        self._refusals: set[tuple[str, str]] = set()
        self._last_heard = -math.inf
        self.dropped_bytes = 0

    @property
    def clock_state(self) -> ClockState:
        """Offset, drift and re-anchors of the device's clock."""
        return self._clock.state

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters of all streams by source_id."""
        return self._outlets.counters

    @property
    def silence_s(self) -> float:
        """Seconds since the device last said something that made sense."""
        return local_clock() - self._last_heard

    def open(self, info: DeviceInfo, rates: Mapping[str, float]) -> None:
        """Create the outlets, at the first connection; see :meth:`DeviceOutlets.open`."""
        self._outlets.open(info, rates)
        self.heard()

    def close(self) -> None:
        """Destroy the outlets."""
        self._outlets.close()

    def release(self) -> None:
        """Push states that wait for a receiver; to be called once a second or so."""
        self._outlets.release()

    def heard(self) -> None:
        """Note that the device said something valid; the watchdog starts anew."""
        self._last_heard = local_clock()

    def observe(self, device_s: float, arrival_s: float) -> None:
        """Take in the device time of a packet's last sample and its LSL time of arrival."""
        jump = self._clock.observe(device_s, arrival_s)
        if jump is not None:
            _log.warning(
                "the device's clock jumped; its stamps are re-anchored",
                **self._names(),
                cause=jump.reason.value,
                seconds=round(jump.size_s, 3),
            )

    def restart_clock(self) -> None:
        """Map device times anew from the next observation on: the device counts anew.

        Nothing can be emitted with device times before that observation.
        """
        self._clock.restart()

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        """Push samples.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        device_times : sequence of float, length n_samples
            Device clock of each sample in seconds.
        """
        self.emit_at(data_name, samples, [self._clock.to_lsl(time) for time in device_times])

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        """Push samples that the device does not stamp, with times on the LSL clock already.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        lsl_times : sequence of float, length n_samples
            LSL clock at each sample, as near as can be told, in seconds.
        """
        stamps = lsl_times
        if max(lsl_times, default=0.0) < local_clock() + MAX_STAMP_ERROR_S:
            # One from the future is refused; guarded, it would push all later ones there, too.
            stamps = self._guarded(data_name, lsl_times)
        refusal = self._outlets[data_name].push(samples, stamps)
        if refusal is not None and (data_name, refusal) not in self._refusals:
            # Once per cause: the counter tells how often.
            self._refusals.add((data_name, refusal))
            _log.error("samples were refused", **self._names(), data=data_name, cause=refusal)

    def emit_value(self, data_name: str, value: float | None, device_s: float) -> None:
        """Push one value of a one-channel stream; None is "no value", which sends nothing."""
        if value is not None:
            self.emit(data_name, [value], [device_s])

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Push one string sample measured at a time of the device's clock."""
        (stamp,) = self._guarded(data_name, [self._clock.to_lsl(device_s)])
        self._outlets[data_name].push_text(text, stamp)

    def lost(self, data_name: str, count: int) -> None:
        """Count samples that the device measured and that never arrived."""
        self._outlets[data_name].counters.lost += count

    def _guarded(self, data_name: str, stamps: Sequence[float]) -> list[float]:
        return self._stamps.setdefault(data_name, MonotonicStamps()).apply(stamps)

    def _names(self) -> dict[str, Any]:
        return {"sensor": self.identity.sensor, "unit": self.identity.unit}
