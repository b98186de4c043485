"""LSL outlets that check, count and push a stream's samples."""

from __future__ import annotations

import math
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import wraps
from itertools import pairwise
from typing import Any, NamedTuple, ParamSpec

import numpy as np
import pylsl
import structlog
from numpy.typing import ArrayLike, NDArray

from biosensor_common import naming
from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_common.lsl.outlet import LslOutlet
from biosensor_common.lsl_header import append_children, describe
from biosensor_common.quantities import ChannelFormat, waits_for_receivers
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice, SensorSpec, StreamSpec
from biosensor_gateway.streaming.counters import GATEWAY, Counters
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

# A stamp further off is not on the LSL clock at all; one of what had to wait may be older.
MAX_STAMP_ERROR_S = 30.0
MAX_STAMP_AGE_S = LONGEST_DELAY_S + MAX_STAMP_ERROR_S

# How long receivers take to find a new stream and to attach to it.
ATTACH_TIME_S = 5.0
MAX_WAITING = 256
# How long receivers of a killed agent's stream need to be back: liblsl searches for 1 s at least,
# for 1.25 s with KnownPeers, and then waits for another 0.5 s. If nobody is, there may be nobody.
RETURN_TIME_S, LATEST_RETURN_S = 1.8, 5.0
MAX_AWAITING_RETURN = 8192

_DTYPES: dict[ChannelFormat, np.dtype[Any]] = {
    ChannelFormat.FLOAT32: np.dtype(np.float32),
    ChannelFormat.DOUBLE64: np.dtype(np.float64),
    ChannelFormat.INT32: np.dtype(np.int32),
    ChannelFormat.INT16: np.dtype(np.int16),
    ChannelFormat.INT8: np.dtype(np.int8),
}


class _Fault(NamedTuple):
    what: Refusal
    facts: Mapping[str, Any]


def _fault(what: Refusal, **facts: object) -> _Fault:
    return _Fault(what, facts)


class Nowhere:
    """The used part of an LSL outlet, which discards samples."""

    def push_sample(self, x: Sequence[str], timestamp: float = 0.0) -> None:
        """Discard a text."""

    def push_chunk(self, x: NDArray[Any], timestamp: list[float]) -> None:
        """Discard samples."""

    def have_consumers(self) -> bool:
        """Return True, so that nothing waits for a receiver."""
        return True


class Outlet:
    """One LSL outlet of a declared stream.

    LSL drops samples without a receiver, and a device sends its battery or signal strength right
    after the outlet was created. So the first samples of a stream of states wait, with their own
    stamps, until a receiver had time to connect and did; see `release`. So do the samples of any
    stream that has just lost its receivers; see `await_return`.
    """

    def __init__(
        self,
        stream: StreamSpec,
        identity: DeviceIdentity,
        info: DeviceInfo,
        clock: Clock = LSL_CLOCK,
    ) -> None:
        if isinstance(stream.rate, FromDevice):
            raise TypeError(f"stream {stream.data_name!r}: its rate must be known at this point")
        self._clock = clock
        self.stream = stream
        self.nominal_rate = stream.rate
        self._is_regular, self._is_float = stream.is_regular, stream.format.is_float
        single = stream.format is ChannelFormat.FLOAT32
        self._largest = np.finfo(np.float32 if single else np.float64).max
        self.source_id = naming.source_id(identity, stream.data_name)
        self.name = naming.lsl_name(identity, stream.data_name)
        # counters, refusals: counts of its samples, and of those that were left out or changed.
        self.counters = Counters()
        self.refusals = Refusals(clock=clock)
        lsl_info = pylsl.StreamInfo(
            self.name,
            stream.content_type.value,
            len(stream.channels),
            stream.rate,
            stream.format.value,
            self.source_id,
        )
        append_children(lsl_info.desc(), describe(stream, identity, info))
        self._outlet = self._made(lsl_info)
        # What a device says once or rarely, and what holds until it says otherwise.
        self._waits = waits_for_receivers(
            stream.content_type, is_regular=stream.is_regular, is_state=stream.is_state
        )
        self._ready_s, self._latest_s = self._clock() + ATTACH_TIME_S, math.inf
        # nothing is dropped: `_wait` reports what is given up
        self._waiting: deque[tuple[NDArray[Any], float]] = deque(maxlen=MAX_WAITING)

    def _made(self, info: pylsl.StreamInfo) -> LslOutlet | Nowhere:
        """Create LSL's outlet."""
        return LslOutlet(info)

    @property
    def session(self) -> str:
        """The LSL session; empty if it does not send over LSL."""
        sends = self._outlet
        return "" if isinstance(sends, Nowhere) else sends.get_info().session_id()

    def await_return(self) -> None:
        """Queue the next samples until the receivers from before a kill have reconnected."""
        if not self._waits:
            self._waits = True
            now = self._clock()
            self._ready_s, self._latest_s = now + RETURN_TIME_S, now + LATEST_RETURN_S
            self._waiting = deque(maxlen=MAX_AWAITING_RETURN)  # nothing is dropped: as above

    def push(self, samples: ArrayLike, stamps: Sequence[float]) -> str | None:
        """Push samples that are newer than all previous ones.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            Values in the units of the declaration; NaN is "no value", which regular streams may
            contain, but a sample of an irregular one must not only consist of it.
        stamps : sequence of float, length n_samples
            LSL time of each sample, never decreasing.

        Returns
        -------
        str or None
            Why the samples were refused; None if they were pushed.
        """
        values = np.asarray(samples, dtype=np.float64)
        if values.ndim == 1:
            values = values[:, np.newaxis]
        fault = self._fault(values, stamps)
        if fault is not None:
            self.counters.refused += len(stamps)
            self.refusals.refuse(fault.what, len(stamps), **fault.facts)
            return fault.what.cause(**fault.facts)
        if len(stamps):
            dtype = _DTYPES[self.stream.format]
            data = np.ascontiguousarray(values, dtype=dtype)
            if self._waits and not self._has_audience():
                self._wait(data, stamps)
                # nothing is dropped: they wait for a receiver
                return None
            if self._waiting:
                self.release()
            self._outlet.push_chunk(data, list(stamps))
            self._count(stamps)
        # nothing is dropped: they are pushed
        return None

    def _wait(self, data: NDArray[Any], stamps: Sequence[float]) -> None:
        most = self._waiting.maxlen or 0
        given_up = min(len(stamps), len(self._waiting) + len(stamps) - most)
        if given_up > 0:
            self.refusals.refuse(Refusal.WAITED_TOO_LONG, given_up, most=most)
        self._waiting.extend(zip(data, stamps, strict=True))
        self.counters.waited += len(stamps)

    def release(self) -> None:
        """Push the samples that wait for receivers, if the wait is over."""
        if self._waiting and self._has_audience():
            data, stamps = zip(*self._waiting, strict=True)
            self._waiting.clear()
            self._outlet.push_chunk(np.array(data), list(stamps))
            self._count(stamps)

    def withhold_waiting(self) -> None:
        """Discard the samples that wait for receivers, because their device was paused."""
        if self._waiting:
            self.withhold(len(self._waiting))
            self._waiting.clear()

    def withhold(self, count: int) -> None:
        """Count samples that are suppressed by a pause."""
        self.counters.withheld += count
        self.refusals.refuse(Refusal.PAUSED, count)

    def _has_audience(self) -> bool:
        if not self._waits:
            return True
        now = self._clock()
        is_time = now >= self._ready_s
        has_one = is_time and (now >= self._latest_s or self._outlet.have_consumers())
        # Once is enough: whoever comes later gets what is measured later.
        self._waits = not has_one
        return has_one

    def close(self) -> None:
        """Destroy the LSL outlet now, even if this object is still referenced.

        The traceback of a failed task would otherwise keep it visible, and it would be recorded.
        """
        del self._outlet

    def have_consumers(self) -> bool:
        """Whether the stream has a receiver now."""
        return self._outlet.have_consumers()

    def push_text(self, text: str, stamp: float) -> None:
        """Push one string sample."""
        self._outlet.push_sample([text], stamp)
        self._count([stamp])

    def _count(self, stamps: Sequence[float]) -> None:
        self.counters.pushed += len(stamps)
        self.counters.last_stamp = stamps[-1]

    def _fault(self, values: NDArray[np.float64], stamps: Sequence[float]) -> _Fault | None:
        expected = (len(stamps), len(self.stream.channels))
        if values.shape != expected and (values.size or len(stamps)):
            return _fault(Refusal.WRONG_SHAPE, shape=values.shape, expected=expected)
        if not len(stamps):
            # nothing is dropped: there is nothing
            return None
        return self._stamp_fault(stamps) or self._value_fault(values)

    def _stamp_fault(self, stamps: Sequence[float]) -> _Fault | None:
        neighbours = pairwise([self.counters.last_stamp, *stamps])
        if not all(math.isfinite(b) and a <= b for a, b in neighbours):
            return _fault(Refusal.BACKWARDS)
        now = self._clock()
        if stamps[0] < now - MAX_STAMP_AGE_S or stamps[-1] > now + MAX_STAMP_ERROR_S:
            return _fault(Refusal.NOT_LSL_TIME)
        return None  # nothing is dropped: they are as they should be

    def _value_fault(self, values: NDArray[np.float64]) -> _Fault | None:
        missing = np.isnan(values)
        # A value may become infinite in the stream's format.
        if (np.abs(values) > self._largest).any():
            return _fault(Refusal.INFINITE)
        if not self._is_regular and missing.all(axis=1).any():
            return _fault(Refusal.NO_VALUE, kind="an irregular")
        if self._is_float:
            return None  # nothing is dropped: the others hold any number
        if missing.any():
            return _fault(Refusal.NO_VALUE, kind="an integer")
        limits = np.iinfo(_DTYPES[self.stream.format])
        low, high = self.stream.message_type.integer_range or (limits.min, limits.max)
        if (values < low).any() or (values > high).any():
            return _fault(Refusal.OUT_OF_RANGE, low=low, high=high)
        return None  # nothing is dropped: they fit


class DeviceOutlets:
    """All outlets of one device; they outlive its connections.

    They are created at the first successful connection and live until the
    agent ends: a drop-out is a gap, not a vanished stream.
    """

    def __init__(
        self,
        identity: DeviceIdentity,
        spec: SensorSpec,
        clock: Clock = LSL_CLOCK,
        kind: type[Outlet] = Outlet,
    ) -> None:
        self._kind = kind
        self.identity = identity
        self._clock = clock
        self._sensor = spec
        self._outlets: dict[str, Outlet] = {}
        self._expected: DeviceInfo | None = None

    def expect(self, info: DeviceInfo, rates: Mapping[str, float]) -> bool:
        """Create the outlets as they were before; return whether that is possible.

        They are replaced at the connection if the device then reports something else. Samples
        wait for returning receivers; see :meth:`Outlet.await_return`. Parameters as in
        :meth:`open`.
        """
        declared = self._sensor.streams
        told = [rates.get(each.data_name, each.rate) for each in declared]
        if any(isinstance(rate, FromDevice) for rate in told):
            return False
        self.open(info, rates)
        self._expected = info
        for outlet in self._outlets.values():
            outlet.await_return()
        return True

    def open(
        self, info: DeviceInfo, rates: Mapping[str, float]
    ) -> dict[str, tuple[float | FromDevice, float | FromDevice]]:
        """Create the outlets that do not exist yet; rebuild those whose rate changed.

        Parameters
        ----------
        info
            What the device reports of itself; the declaration fills in the rest.
        rates
            Nominal rates in Hz by data name, for streams whose rate the device sets.

        Returns
        -------
        dict
            Previous and new rate of the rebuilt outlets, by data name.
        """
        changed: dict[str, tuple[float | FromDevice, float | FromDevice]] = {}
        was_wrong = self._expected not in {None, info}
        self._expected = None
        info = replace(
            info,
            manufacturer=info.manufacturer or self._sensor.manufacturer,
            model=info.model or self._sensor.model,
        )
        for declared in self._sensor.streams:
            stream = replace(declared, rate=rates.get(declared.data_name, declared.rate))
            present = self._outlets.get(stream.data_name)
            if present is None or present.stream != stream or was_wrong:
                if present is not None and present.stream != stream:
                    changed[stream.data_name] = (present.stream.rate, stream.rate)
                # The old outlet must be gone before one of the same source_id appears.
                self._outlets.pop(stream.data_name, None)
                del present
                made = self._kind(stream, self.identity, info, self._clock)
                self._outlets[stream.data_name] = made
        return changed

    def close(self) -> None:
        """Destroy all outlets."""
        for outlet in self._outlets.values():
            outlet.close()
        self._outlets.clear()

    def release(self) -> None:
        """Push samples that wait for a receiver; see :class:`Outlet`."""
        for outlet in self._outlets.values():
            outlet.release()

    def withhold_waiting(self) -> None:
        """Discard samples that wait for a receiver; see :class:`Outlet`."""
        for outlet in self._outlets.values():
            outlet.withhold_waiting()

    def __getitem__(self, data_name: str) -> Outlet:
        return self._outlets[data_name]

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters by source_id."""
        return {outlet.source_id: outlet.counters for outlet in self._outlets.values()}

    @property
    def refusals(self) -> dict[str, Refusals]:
        """Data that were left out or changed, by source_id."""
        return {outlet.source_id: outlet.refusals for outlet in self._outlets.values()}

    @property
    def rates(self) -> dict[str, float]:
        """Nominal rates in Hz by source_id, 0 of irregular streams."""
        outlets = self._outlets.values()
        return {each.source_id: each.nominal_rate for each in outlets}


def differences(before: DeviceInfo, after: DeviceInfo) -> dict[str, tuple[object, object]]:
    """Return changed facts that a device reports of itself, if it reported both."""
    then, now = asdict(before), asdict(after)
    return {
        name: (then[name], now[name])
        for name in then
        if then[name] and now[name] and then[name] != now[name]
    }


def own_outlet(data_name: str, clock: Clock = LSL_CLOCK) -> Outlet:
    """Create the outlet of a stream without which the agent cannot run.

    Raises
    ------
    RuntimeError
        LSL has no free port.
    OSError, ValueError
        This computer has no name, or one that is not valid text.
    """
    identity = DeviceIdentity(GATEWAY.name, socket.gethostname())
    return Outlet(GATEWAY.stream(data_name), identity, DeviceInfo(model=GATEWAY.model), clock)


def spare_outlet(data_name: str, refusals: Refusals, clock: Clock = LSL_CLOCK) -> Outlet | None:
    """Create the outlet of an optional stream; a failure is reported."""
    try:
        return own_outlet(data_name, clock)
    except (OSError, RuntimeError, ValueError):
        log = structlog.get_logger(f"biosensor_gateway.{data_name}")
        refusals.refuse(Refusal.NO_OUTLET, about=data_name, name=data_name)
        log.exception(f"there is no stream of {data_name}")
        return None


_Given = ParamSpec("_Given")

_log = structlog.get_logger("biosensor_gateway.events")


def log_errors(method: Callable[_Given, None]) -> Callable[_Given, None]:
    """Decorate a function so that it never raises: only its first error is logged."""
    is_told = False

    @wraps(method)
    def guarded(*given: _Given.args, **named: _Given.kwargs) -> None:
        nonlocal is_told
        try:
            method(*given, **named)
        # nothing is dropped: of sensors; what the agent wanted to tell of itself is in the log
        except Exception as error:  # noqa: BLE001 - whatever it is, samples flow on
            if not is_told:
                is_told = True
                name = method.__name__
                # nothing is dropped: as above
                _log.exception("an event is not announced", of=name, error=str(error))

    return guarded
